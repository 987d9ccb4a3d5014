"""The command `gmdx`. What is slow to import is imported by the command that needs it."""

import dataclasses
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table
from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, Positional, arg
from tyro.conf import subcommand as named
from tyro.constructors import PrimitiveConstructorSpec

from gmdx.cli import bench, bench_parity, bench_trials
from gmdx.cli.terminal import complain, console, following, interrupts_kept, say
from gmdx.config import as_toml, load_toml, merge
from gmdx.errors import GmdxError, GripperError, UsageError
from gmdx.machine.cores import THREAD_VARIABLES, available_cores
from gmdx.machine.tasks import run_tasks

if TYPE_CHECKING:
    from gmdx.objects.sources import ObjectSource
    from gmdx.pipeline.generate import GenerateConfig, Summary

DONE, NOTHING_PRODUCED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130

_DESCRIPTION = """Annotated planar-grasp datasets from object meshes.

A first dataset, from the objects that come along:

    gmdx generate bundled --out runs/first
    gmdx inspect runs/first
"""


def _optional(kind: type[int] | type[str], metavar: str, default: str) -> tuple[Any, Any]:
    """A flag that is None where it is not given, with what holds then in its help."""
    spec: PrimitiveConstructorSpec[Any] = PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: kind(words[0]),
        is_instance=lambda value: value is None or isinstance(value, kind),
        str_from_instance=lambda value: [str(value)],
    )
    return spec, arg(help_behavior_hint=f"(default: {default})")


_Objects = Annotated[tuple[str, ...], Positional, arg(metavar="OBJECTS...", help_behavior_hint="")]
_Cache = Annotated[str | None, *_optional(str, "DIR", "~/.cache/gmdx")]


@dataclasses.dataclass(frozen=True)
class Generate:
    """Annotate objects with grasps, trials and metrics. Run it again to continue."""

    objects: _Objects
    """any mix of: bundled, mesh files, folders, globs, pybullet:random_urdfs[:N]"""
    out: Annotated[Path, arg(metavar="DIR")]
    """folder of the dataset"""
    grasps: Annotated[int | None, *_optional(int, "INT", "64")] = None
    """grasps per scene"""
    scenes: Annotated[int | None, *_optional(int, "INT", "2")] = None
    """scenes per object, each from a random orientation"""
    trials: Annotated[int | None, *_optional(int, "INT", "5")] = None
    """simulated trials per grasp"""
    gripper: Annotated[str | None, *_optional(str, "NAME|FILE", "parallel_jaw")] = None
    """a shipped gripper, or the description of your own"""
    engine: Annotated[str | None, *_optional(str, "NAME", "mujoco")] = None
    """what runs the trials: mujoco (C, on the CPU), warp (many objects at once on NVIDIA GPUs),
    bullet, or auto (warp where there is such a GPU, else mujoco)"""
    parallel_trials: Annotated[
        int | None, *_optional(int, "INT", "what the device has room for")
    ] = None
    """side by side on a device; without effect on results, on a GPU but for their last bits"""
    workers: Annotated[int | None, *_optional(int, "INT", "one per core")] = None
    """processes; results do not depend on it"""
    seed: Annotated[int | None, *_optional(int, "INT", "0")] = None
    """of every random number"""
    config: Annotated[str | None, *_optional(str, "FILE", "none")] = None
    """TOML file with more settings, as `gmdx config` prints it; flags win over it"""
    cache: _Cache = None
    """folder of prepared objects"""

    def run(self) -> int:
        """Generate the dataset."""
        with interrupts_kept():
            from gmdx.pipeline.generate import generate
            from gmdx.trials.engines import open_engine

            settings = self.settings()
            open_engine(settings.engine)  # imports what it needs

        with following("grasps") as on_progress:
            summary = generate(self.objects, self.out, settings, on_progress=on_progress)
        say(_last_line(summary))
        return DONE if summary.counts["objects"] else NOTHING_PRODUCED

    def settings(self) -> "GenerateConfig":
        """The defaults, the configuration file over them, and the flags over both."""
        from gmdx.pipeline.generate import GenerateConfig

        config = GenerateConfig(workers=available_cores())
        if self.config is not None:
            config = merge(config, load_toml(self.config))
        names = (
            "grasps", "scenes", "trials", "gripper", "engine", "parallel_trials", "workers",
            "seed", "cache",
        )  # fmt: skip
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return merge(config, given)


@dataclasses.dataclass(frozen=True)
class Config:
    """Print every setting of `gmdx generate` as a TOML file to edit."""

    def run(self) -> int:
        """Print the defaults."""
        from gmdx.pipeline.generate import GenerateConfig

        say(as_toml(GenerateConfig(workers=available_cores())))
        return DONE


@dataclasses.dataclass(frozen=True)
class Inspect:
    """Show what a dataset holds: counts, success, outcomes, missing values, failures, cost."""

    dataset: Annotated[Path, Positional, arg(metavar="DIR")]
    """folder of the dataset"""

    def run(self) -> int:
        """Print the tables."""
        from gmdx.dataset.inspect import overview, tables
        from gmdx.dataset.read import read_dataset

        screen = console()
        for table in tables(overview(read_dataset(self.dataset))):
            screen.print(table)
        return DONE


@dataclasses.dataclass(frozen=True)
class Show:
    """Draw a scene's grasps over its depth image, or one grasp's contacts from close up."""

    dataset: Annotated[Path, Positional, arg(metavar="DIR")]
    """folder of the dataset"""
    object: Annotated[str, arg(metavar="ID")]
    """which object"""
    out: Annotated[Path, arg(metavar="FILE", aliases=("-o",))]
    """picture to write: .png, .pdf or .svg"""
    scene: int = 0
    """which scene of the object"""
    metric: str = "sim_success"
    """what the colours show; `gmdx metrics` lists the names"""
    view: int = 0
    """which image of the scene"""
    most: int = 20
    """draw at most so many grasps, spread over the scene; 0: all"""
    grasp: Annotated[int | None, *_optional(int, "ID", "none")] = None
    """draw this grasp from close up instead"""
    gripper: Annotated[str | None, *_optional(str, "NAME|FILE", "the dataset's")] = None
    """for a close-up, where the dataset was made with a gripper of your own"""

    def run(self) -> int:
        """Write the picture."""
        from gmdx.dataset.read import read_dataset
        from gmdx.pictures.figure import save_figure
        from gmdx.pictures.show import grasp_picture, scene_picture, shipped_gripper
        from gmdx.scenes.gripper import load_gripper

        dataset = read_dataset(self.dataset)
        if self.grasp is None:
            most = None if self.most == 0 else self.most
            figure = scene_picture(
                dataset, self.object, self.scene, metric=self.metric, view=self.view, most=most
            )
        else:
            given = self.gripper
            gripper = shipped_gripper(dataset) if given is None else load_gripper(given)
            figure = grasp_picture(dataset, self.object, self.scene, self.grasp, gripper=gripper)
        save_figure(figure, self.out)
        say(f"wrote {self.out}")
        return DONE


@dataclasses.dataclass(frozen=True)
class Metrics:
    """Print the table of the 36 metrics."""

    def run(self) -> int:
        """Print one row a metric."""
        from gmdx.metrics.table import METRICS

        table = Table("#", "name", "kind", "unit", "definition", title="The 36 metrics")
        for metric in METRICS:
            unit = metric.unit if metric.unit else "-"
            table.add_row(str(metric.number), metric.name, metric.kind, unit, metric.definition)
        console().print(table)
        return DONE


@dataclasses.dataclass(frozen=True)
class Prepare:
    """Prepare objects for physics, and report what was repaired."""

    objects: _Objects
    """any mix of: bundled, mesh files, folders, globs, pybullet:random_urdfs[:N]"""
    workers: Annotated[int | None, *_optional(int, "INT", "one per core")] = None
    """processes"""
    cache: _Cache = None
    """folder of prepared objects"""

    def run(self) -> int:
        """Print a report per object."""
        with interrupts_kept():
            from gmdx.objects.sources import resolve

        sources = resolve(list(self.objects))
        workers = available_cores() if self.workers is None else self.workers
        if workers < 1:
            raise UsageError(f"--workers must be at least 1, not {workers}")
        tasks = [
            _PrepareTask(source, None if self.cache is None else Path(self.cache))
            for source in sources
        ]
        failed = 0
        for finished in run_tasks(_prepared, tasks, workers=min(workers, len(tasks))):
            object_id, result = finished.task.source.object_id, finished.result
            if isinstance(result, _Report):
                say(result.text)
            else:
                failed += 1
                say(f"{object_id}: failed: {result}")
        say(f"{len(tasks) - failed} objects prepared, {failed} failed")
        return DONE if failed < len(tasks) else NOTHING_PRODUCED


@dataclasses.dataclass(frozen=True)
class _PrepareTask:
    source: "ObjectSource"
    cache: Path | None  # None: the user's own


@dataclasses.dataclass(frozen=True)
class _Report:
    text: str


@dataclasses.dataclass(frozen=True)
class Bench:
    """Measure the pipeline, its trials, their engines, its depth images or its epsilon here."""

    of: (
        Annotated[bench.Pipeline, named("pipeline")]
        | Annotated[bench_trials.Trials, named("trials")]
        | Annotated[bench_parity.Parity, named("parity")]
        | Annotated[bench.Depth, named("depth")]
        | Annotated[bench.Epsilon, named("epsilon")]
        | Annotated[bench.Patches, named("patches")]
    )

    def run(self) -> int:
        """Run the chosen measurement."""
        return self.of.run()


@dataclasses.dataclass(frozen=True)
class Bias:
    """Find out how much a dataset's labels depend on the simulator: its grasps in another one.

    The same grasps, scenes, schedule and pose noise run in both engines, and in the dataset's own
    with other noise, half the time step and other hulls: the noise floor. Run it again to continue.
    """

    dataset: Annotated[Path, Positional, arg(metavar="DATASET")]
    """folder of the dataset"""
    out: Annotated[Path, arg(metavar="DIR")]
    """folder of the study: pairs.parquet, bias.json, report.html"""
    objects: Annotated[int | None, *_optional(int, "INT", "all")] = None
    """objects to replay, chosen by the seed"""
    grasps: int = 32
    """grasps of each object, chosen by the seed; 0: all"""
    seed: int = 0
    """of the choice and of the intervals' resampling"""
    engine: str = "bullet"
    """the other engine"""
    floor: bool = True
    """also run the dataset's engine against itself"""
    gripper: Annotated[str | None, *_optional(str, "NAME|FILE", "the dataset's")] = None
    """where the dataset was made with a gripper of your own"""
    workers: Annotated[int | None, *_optional(int, "INT", "one per core")] = None
    """processes; results do not depend on it"""

    def run(self) -> int:
        """Run the study, and show how far the engines agree."""
        with interrupts_kept():
            from gmdx.scenes.gripper import load_gripper
            from gmdx.studies.bias import BiasConfig, bias_study, summary, summary_head

        config = BiasConfig(
            objects=self.objects,
            grasps=None if self.grasps == 0 else self.grasps,
            seed=self.seed,
            engine=self.engine,
            noise_floor=self.floor,
            workers=available_cores() if self.workers is None else self.workers,
        )
        gripper = None if self.gripper is None else load_gripper(self.gripper)
        with following("grasps", things="replays") as show:
            study = bias_study(self.dataset, self.out, config, gripper=gripper, on_progress=show)
        table = Table(*summary_head(study), title=f"{study.engines.grasps} grasps in both engines")
        for row in summary(study):
            table.add_row(*row)
        console().print(table)
        failed = f"; {len(study.failures)} replays failed" if study.failures else ""
        say(f"{study.root}: pairs.parquet, bias.json and report.html{failed}")
        return DONE if study.engines.grasps else NOTHING_PRODUCED


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Find out which physical and numerical parameters the labels depend on.

    Scenes and grasps stay the same; the trials change. Run it again to continue.
    """

    objects: _Objects
    """any mix of: bundled, mesh files, folders, globs, pybullet:random_urdfs[:N]"""
    out: Annotated[Path, arg(metavar="DIR")]
    """folder of the study"""
    parameters: Annotated[
        str, arg(metavar="NAME,NAME,...", help_behavior_hint="(default: all)")
    ] = ""
    """what to vary: friction, mass, closing_force, pose_noise, angle_noise, grasp_height,
    closing_speed, lift_time, timestep, impratio, solref, solimp, patch_radius, hulls.
    seed comes along: what it does is chance"""
    method: str = "morris"
    """morris screens, sobol shares out the variance, oat draws curves one at a time"""
    runs: Annotated[
        int | None, *_optional(int, "INT", "10 trajectories, 64 rows, or 7 values of each")
    ] = None
    """of each object at most: the budget"""
    grasps: int = 16
    """grasps of each object"""
    trials: int = 5
    """simulated trials per grasp"""
    gripper: Annotated[str | None, *_optional(str, "NAME|FILE", "parallel_jaw")] = None
    """a shipped gripper, or the description of your own"""
    workers: Annotated[int | None, *_optional(int, "INT", "one per core")] = None
    """processes; results do not depend on it"""
    seed: int = 0
    """of scenes, grasps, pose noise and design"""
    cache: _Cache = None
    """folder of prepared objects"""

    def run(self) -> int:
        """Run the study, and show what matters most."""
        with interrupts_kept():
            from gmdx.studies.sensitivity import (
                SensitivityConfig,
                sensitivity_study,
                summary,
                table,
            )

        names = tuple(name.strip() for name in self.parameters.split(",") if name.strip())
        given: dict[str, Any] = {"parameters": names} if names else {}
        given |= {} if self.gripper is None else {"gripper": self.gripper}
        given |= {} if self.cache is None else {"cache": Path(self.cache)}
        config = SensitivityConfig(
            method=self.method,
            runs=self.runs,
            grasps=self.grasps,
            trials=self.trials,
            seed=self.seed,
            workers=available_cores() if self.workers is None else self.workers,
            **given,
        )
        with following("trials", things="runs") as show:
            study = sensitivity_study(self.objects, self.out, config, on_progress=show)
        console().print(table(summary(study)))
        say(f"{study.root}: runs.parquet, sensitivity.json, figures/ and report.html")
        return DONE


def _prepared(task: _PrepareTask) -> "_Report | str":
    """The report on one object, or why there is none."""
    from gmdx.objects.prepare import prepare
    from gmdx.objects.report import describe

    try:
        obj = prepare(task.source, cache="user" if task.cache is None else task.cache)
        return _Report(describe(obj))
    except GmdxError as error:
        return str(error)
    except Exception as error:  # one object's surprise is not the others'
        return f"{type(error).__name__}: {error}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words of the command line; those of this process by default.

    Returns:
        The exit code: 0 the run finished, 1 nothing was produced, 2 wrong usage, 130 interrupted.
    """
    for name in THREAD_VARIABLES:  # workers are the parallelism
        os.environ.setdefault(name, "1")
    command = tyro.cli(
        _Command,
        config=(OmitArgPrefixes, OmitSubcommandPrefixes),
        prog="gmdx",
        description=_DESCRIPTION,
        args=argv,
    )
    try:
        code: int = command.run()
    except KeyboardInterrupt:
        complain("interrupted; the same command continues after what is complete")
        return INTERRUPTED
    except GmdxError as error:
        complain(f"gmdx: {error}")
        wrong = isinstance(error, UsageError | GripperError)
        return WRONG_USAGE if wrong else NOTHING_PRODUCED
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    return code


def _last_line(summary: "Summary") -> str:
    """What a run came to."""
    counts = summary.counts
    there = f", {summary.present} already there" if summary.present else ""
    return (
        f"{summary.root}: {counts['objects']} objects, {counts['scenes']} scenes, "
        f"{counts['grasps']} grasps ({summary.produced} objects new{there}); "
        f"{summary.failed} of {summary.requested} objects failed, "
        f"{counts['failures']} lines in failures.jsonl"
    )


_Command = (
    Annotated[Generate, named("generate")]
    | Annotated[Config, named("config")]
    | Annotated[Inspect, named("inspect")]
    | Annotated[Show, named("show")]
    | Annotated[Metrics, named("metrics")]
    | Annotated[Prepare, named("prepare")]
    | Annotated[Bias, named("bias")]
    | Annotated[Sensitivity, named("sensitivity")]
    | Annotated[Bench, named("bench")]
)
