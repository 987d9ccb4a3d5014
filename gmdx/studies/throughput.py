"""How fast the stages are. All figures are processor seconds, measured in the run that they are of.

Wall-clock time only enters where several processes are compared.
"""

import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from gmdx.dataset.read import Dataset
from gmdx.objects.model import ObjectModel
from gmdx.scenes.camera import CameraConfig, render
from gmdx.scenes.scene import Scene


@dataclass(frozen=True)
class PipelineFigures:
    """What annotating a grasp cost in one dataset."""

    objects: int
    grasps: int
    prepare_seconds: float  # per object; little where the cache has it
    seconds: dict[str, float]  # per grasp, by stage after preparing
    metric_seconds: dict[str, float]  # per grasp, by stage of the metrics
    steps: float  # of the engine, per grasp
    step_seconds: float  # s, of one step
    step_share: float  # of the trials' wall-clock time, inside the engine's step

    @property
    def total(self) -> float:
        """Processor seconds per grasp, preparing left out."""
        return sum(self.seconds.values())


@dataclass(frozen=True)
class WorkerFigures:
    """One run of the pipeline with a number of processes."""

    workers: int
    wall_seconds: float
    ratio: float  # of the first run's wall-clock time to this one's


@dataclass(frozen=True)
class DepthFigures:
    """What depth images of one object cost."""

    object_id: str
    faces: int
    images: int
    images_per_second: float


def pipeline_figures(dataset: Dataset) -> PipelineFigures:
    """Figures from the `cost.json` files of a dataset.

    Raises:
        DatasetError: A file is missing or damaged.
    """
    stages: Counter[str] = Counter()
    metrics: Counter[str] = Counter()
    trials: Counter[str] = Counter()
    grasps = 0
    for object_id in dataset.objects:
        cost = dataset.cost(object_id)
        stages.update(cost["cpu_seconds"])
        metrics.update(cost["metric_seconds"])
        trials.update(cost["trials"])
        grasps += cost["grasps"]
    return PipelineFigures(
        objects=len(dataset.objects),
        grasps=grasps,
        prepare_seconds=stages.pop("prepare") / len(dataset.objects),
        seconds={name: seconds / grasps for name, seconds in stages.items()},
        metric_seconds={name: seconds / grasps for name, seconds in metrics.items()},
        steps=trials["steps"] / grasps,
        step_seconds=trials["step_seconds"] / trials["steps"],
        step_share=trials["step_seconds"] / trials["seconds"],
    )


def worker_figures(run: Callable[[int], None], workers: Sequence[int]) -> list[WorkerFigures]:
    """Time one run with each number of processes.

    Args:
        run: Does the whole work with that many processes.
        workers: The numbers; the first is what the others are compared with.
    """
    seconds = []
    for count in workers:
        start = time.perf_counter()
        run(count)
        seconds.append(time.perf_counter() - start)
    return [
        WorkerFigures(count, wall, seconds[0] / wall)
        for count, wall in zip(workers, seconds, strict=True)
    ]


def peak_megabytes() -> float:
    """The most memory that this process, or one that it started and awaited, ever held, MB."""
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, kilobytes elsewhere
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) * unit / 1e6


def depth_figures(scene: Scene, *, images: int, config: CameraConfig | None = None) -> DepthFigures:
    """Render a scene several times, in turn from each of four views.

    Args:
        scene: The object at rest.
        images: How many images to render.
        config: The camera; its number of views is not used.
    """
    config = replace(CameraConfig() if config is None else config, views=4)
    render(scene, config=config)  # what only the first image pays is not counted
    start = time.process_time()
    for k in range(images):
        render(scene, view=k % 4, config=config)
    seconds = time.process_time() - start
    obj: ObjectModel = scene.object
    return DepthFigures(obj.object_id, len(obj.faces), images, images / seconds)


def rows(figures: PipelineFigures) -> Iterator[tuple[str, str]]:
    """Pipeline figures as name and value, for a table."""
    yield "objects", str(figures.objects)
    yield "grasps", str(figures.grasps)
    yield "prepare", f"{figures.prepare_seconds:.2f} s per object"
    for name, seconds in figures.seconds.items():
        yield name, f"{1e3 * seconds:.2f} ms per grasp"
    for name, seconds in figures.metric_seconds.items():
        yield f"  metrics/{name}", f"{1e3 * seconds:.2f} ms per grasp"
    yield "all but prepare", f"{1e3 * figures.total:.2f} ms per grasp"
    yield (
        "engine's steps",
        f"{figures.steps:.0f} per grasp, {1e6 * figures.step_seconds:.1f} us each",
    )
    yield "trials inside the engine's step", f"{100 * figures.step_share:.0f} %"
