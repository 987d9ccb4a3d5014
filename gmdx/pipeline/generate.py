"""The stages in a row: objects in, an annotated dataset out. Composes; holds no mathematics."""

import contextlib
import logging
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gmdx.config import as_dict
from gmdx.dataset.schema import OBJECT_FILE
from gmdx.dataset.store import DatasetStore
from gmdx.errors import Failure
from gmdx.files.folder import OutputError
from gmdx.files.formats import read_json
from gmdx.machine.executor import Crash, Finished
from gmdx.machine.packages import RESULTS, kernel_packages, versions
from gmdx.machine.progress import Follower, OnProgress
from gmdx.machine.tasks import run_tasks
from gmdx.objects.prepare import content_hash
from gmdx.objects.sources import ObjectSource, resolve
from gmdx.pipeline.annotate import annotate
from gmdx.pipeline.config import GenerateConfig
from gmdx.pipeline.device import annotate_in_batches
from gmdx.pipeline.stages import ObjectOutcome, Task, lost
from gmdx.scenes.gripper import Gripper, gripper_record, load_gripper
from gmdx.trials.engines import AUTO, ENGINES, choose, open_engine

logger = logging.getLogger("gmdx")

__all__ = ["GenerateConfig", "Summary", "generate"]

_WITHOUT_EFFECT = ("workers", "block", "parallel_trials", "cache")  # on results


@dataclass(frozen=True)
class Summary:
    """What a finished run came to."""

    root: Path
    requested: int  # objects that the specifications name
    produced: int  # by this run
    present: int  # already there
    failed: int  # objects without a folder
    counts: Mapping[str, int]  # of the whole dataset: objects, scenes, grasps, failures


def generate(
    objects: Sequence[str | Path] | str | Path,
    out: str | Path,
    config: GenerateConfig | None = None,
    *,
    on_progress: OnProgress | None = None,
) -> Summary:
    """Annotate objects into a dataset; with the same arguments, continue one.

    Args:
        objects: `bundled`, files, folders, globs, or `pybullet:random_urdfs[:N]`.
        out: Folder of the dataset.
        config: What to do; see `GenerateConfig`.
        on_progress: Called at the start and after each object.

    Returns:
        What was produced. An object that fails costs nothing but itself: its line in
        `failures.jsonl` says why.

    Raises:
        UsageError: The objects, the gripper, the options or the folder do not work.
        DatasetError: The disk refused a write; what is complete stays.
    """
    config = GenerateConfig() if config is None else config
    if config.engine == AUTO:
        logger.info("engine auto: %s runs the trials", choose(config.engine))
    config = config.resolved()
    specs = [objects] if isinstance(objects, str | Path) else list(objects)
    sources = resolve([str(spec) for spec in specs], leave_out=Path(out))
    gripper = load_gripper(config.gripper)
    failures: list[Failure] = []
    produced = 0

    with DatasetStore(out, _header(config, gripper)) as store:
        store.put_gripper(gripper)
        present = store.complete()
        for source in sources:
            if source.object_id in present:
                _refuse_another(store, source)
        todo = [source for source in sources if source.object_id not in present]
        follower = Follower(len(todo), on_progress)
        tasks = (Task(s, store.attempt(s.object_id), gripper, config) for s in todo)
        with contextlib.closing(_annotated(tasks, config, len(todo))) as finished:
            for item in finished:
                object_id = item.task.source.object_id
                outcome = _crashed(object_id, item.result) if isinstance(item.result, Crash) else (
                    item.result
                )  # fmt: skip
                if outcome.produced:
                    store.publish(item.task.folder, object_id)
                    produced += 1
                else:
                    store.discard(item.task.folder)
                    failures += outcome.failures
                store.record(outcome.failures)
                follower.finished(object_id, count=outcome.grasps, failures=outcome.failures)
        counts = store.finish(failures, sources={source.object_id for source in sources})
    return Summary(
        root=Path(out),
        requested=len(sources),
        produced=produced,
        present=len(sources) - len(todo),
        failed=len(todo) - produced,
        counts=counts,
    )


def _annotated(
    tasks: Iterator[Task], config: GenerateConfig, count: int
) -> Generator[Finished[Task, ObjectOutcome], None, None]:
    """Objects as they are done, on the processor alone or with a device for the trials."""
    workers = min(config.workers, max(count, 1))
    if not ENGINES[config.engine].parallel:
        return run_tasks(annotate, tasks, workers=workers)
    return annotate_in_batches(tasks, config, workers=workers)


def _refuse_another(store: DatasetStore, source: ObjectSource) -> None:
    """Refuse to continue with an object whose source has changed under the same id."""
    path = store.objects / source.object_id / OBJECT_FILE
    try:
        before = read_json(path)["report"]["source"]["sha256"]
    except (KeyError, TypeError) as error:
        raise OutputError(
            f"{path} is damaged; remove its folder, and the same command makes it anew"
        ) from error
    now = content_hash(source.path)
    if before != now:
        raise OutputError(
            f"{store.root} holds {source.object_id!r} made from another content of "
            f"{source.path} (sha256 {before[:12]}..., now {now[:12]}...); give another folder"
        )


def _crashed(object_id: str, crash: Crash) -> ObjectOutcome:
    """The end of an object whose worker process died."""
    return lost(Failure(object_id, None, "worker", "WorkerCrash", str(crash)))


def _header(config: GenerateConfig, gripper: Gripper) -> dict[str, Any]:
    """Everything that results depend on besides the objects."""
    open_engine(config.engine)  # refused by name where it is not installed
    kernels = kernel_packages(config.metric.quality.implementation)
    return {
        "configuration": as_dict(config, leave_out=(*_WITHOUT_EFFECT, "gripper", "seed")),
        "gripper": gripper_record(gripper),
        "seed": config.seed,
        "engine": config.engine,
        "packages": versions((*RESULTS, *ENGINES[config.engine].packages, *kernels)),
    }
