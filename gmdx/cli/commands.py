"""The commands of `gmdx`, by name. Each is imported when it is asked for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gmdx.cli.flags import Command


@dataclass(frozen=True)
class Entry:
    """A command."""

    load: Callable[[], type[Command]]  # imports it
    summary: str  # what the first lines of its docstring say


@dataclass(frozen=True)
class Group:
    """Commands under a name."""

    summary: str
    entries: Mapping[str, "Entry | Group"]


def _generate() -> type[Command]:
    from gmdx.cli.generate import Generate

    return Generate


def _config() -> type[Command]:
    from gmdx.cli.config import Config

    return Config


def _inspect() -> type[Command]:
    from gmdx.cli.datasets import Inspect

    return Inspect


def _show() -> type[Command]:
    from gmdx.cli.show import Show

    return Show


def _metrics() -> type[Command]:
    from gmdx.cli.datasets import Metrics

    return Metrics


def _prepare() -> type[Command]:
    from gmdx.cli.prepare import Prepare

    return Prepare


def _bias() -> type[Command]:
    from gmdx.cli.bias import Bias

    return Bias


def _sensitivity() -> type[Command]:
    from gmdx.cli.sensitivity import Sensitivity

    return Sensitivity


def _bench_pipeline() -> type[Command]:
    from gmdx.cli.bench import Pipeline

    return Pipeline


def _bench_trials() -> type[Command]:
    from gmdx.cli.bench import Trials

    return Trials


def _bench_parity() -> type[Command]:
    from gmdx.cli.bench import Parity

    return Parity


def _bench_depth() -> type[Command]:
    from gmdx.cli.bench import Depth

    return Depth


def _bench_epsilon() -> type[Command]:
    from gmdx.cli.bench import Epsilon

    return Epsilon


def _bench_patches() -> type[Command]:
    from gmdx.cli.bench import Patches

    return Patches


_BENCH = Group(
    "Measure the pipeline, its trials, their engines, its depth images or its epsilon here.",
    {
        "pipeline": Entry(
            _bench_pipeline,
            "Seconds per grasp of the whole pipeline by stage, and what more workers bring.",
        ),
        "trials": Entry(
            _bench_trials,
            "Trials and steps a second of every engine, on the same trials of all objects in one "
            "run.",
        ),
        "parity": Entry(
            _bench_parity,
            "How far engines agree with C MuJoCo on the same seeded trials: outcomes and metrics.",
        ),
        "depth": Entry(_bench_depth, "Depth images per second."),
        "epsilon": Entry(
            _bench_epsilon,
            "Epsilon by every method on the same random grasps: processor time and error.",
        ),
        "patches": Entry(
            _bench_patches,
            "Qualities 15 and 23 from all contacts of a pad, against the pair of their means.",
        ),
    },
)
COMMANDS = Group(
    """Annotated planar-grasp datasets from object meshes.

A first dataset, from the objects that come along:

    gmdx generate bundled --out runs/first
    gmdx inspect runs/first
""",
    {
        "generate": Entry(
            _generate,
            "Annotate objects with grasps, trials and metrics. Run it again to continue.",
        ),
        "config": Entry(
            _config,
            "Print every setting of `gmdx generate` as a TOML file to edit.",
        ),
        "inspect": Entry(
            _inspect,
            "Show what a dataset holds: counts, success, outcomes, missing values, failures, cost.",
        ),
        "show": Entry(
            _show,
            "Draw a scene's grasps over its depth image, or one grasp's contacts from close up.",
        ),
        "metrics": Entry(_metrics, "Print the table of the 36 metrics."),
        "prepare": Entry(_prepare, "Prepare objects for physics, and report what was repaired."),
        "bias": Entry(
            _bias,
            "Find out how much a dataset's labels depend on the simulator: its grasps in another "
            "one.",
        ),
        "sensitivity": Entry(
            _sensitivity,
            "Find out which physical and numerical parameters the labels depend on.",
        ),
        "bench": _BENCH,
    },
)
