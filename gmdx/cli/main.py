"""The command `gmdx`: a table of commands, each imported when it is asked for."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from importlib import import_module
from typing import Annotated, Any, NoReturn, Union

import tyro
from tyro.conf import subcommand

from gmdx.cli.exits import Exit
from gmdx.cli.flags import Command, parse
from gmdx.cli.terminal import complain, interrupts_kept
from gmdx.errors import GmdxError, GripperError, UsageError
from gmdx.machine.processes import THREAD_VARIABLES


@dataclass(frozen=True)
class Entry:
    """Where a command is, and what it does."""

    home: str  # module:class
    summary: str  # what the first lines of its docstring say

    def load(self) -> type[Command]:
        """The command's class."""
        module, name = self.home.split(":")
        command: type[Command] = getattr(import_module(module), name)
        return command


@dataclass(frozen=True)
class Group:
    """Commands under a name."""

    summary: str
    entries: Mapping[str, "Entry | Group"]


_BENCH = Group(
    "Measure the pipeline, its trials, their engines, its depth images or its epsilon here.",
    {
        "pipeline": Entry(
            "gmdx.cli.bench:Pipeline",
            "Seconds per grasp of the whole pipeline by stage, and what more workers bring.",
        ),
        "trials": Entry(
            "gmdx.cli.bench:Trials",
            "Trials and steps a second of every engine, on the same trials of all objects in one "
            "run.",
        ),
        "parity": Entry(
            "gmdx.cli.bench:Parity",
            "How far engines agree with C MuJoCo on the same seeded trials: outcomes and metrics.",
        ),
        "depth": Entry("gmdx.cli.bench:Depth", "Depth images per second."),
        "epsilon": Entry(
            "gmdx.cli.bench:Epsilon",
            "Epsilon by every method on the same random grasps: processor time and error.",
        ),
        "patches": Entry(
            "gmdx.cli.bench:Patches",
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
            "gmdx.cli.generate:Generate",
            "Annotate objects with grasps, trials and metrics. Run it again to continue.",
        ),
        "config": Entry(
            "gmdx.cli.config:Config",
            "Print every setting of `gmdx generate` as a TOML file to edit.",
        ),
        "inspect": Entry(
            "gmdx.cli.datasets:Inspect",
            "Show what a dataset holds: counts, success, outcomes, missing values, failures, cost.",
        ),
        "show": Entry(
            "gmdx.cli.show:Show",
            "Draw a scene's grasps over its depth image, or one grasp's contacts from close up.",
        ),
        "metrics": Entry("gmdx.cli.datasets:Metrics", "Print the table of the 36 metrics."),
        "prepare": Entry(
            "gmdx.cli.prepare:Prepare", "Prepare objects for physics, and report what was repaired."
        ),
        "bias": Entry(
            "gmdx.cli.bias:Bias",
            "Find out how much a dataset's labels depend on the simulator: its grasps in another "
            "one.",
        ),
        "sensitivity": Entry(
            "gmdx.cli.sensitivity:Sensitivity",
            "Find out which physical and numerical parameters the labels depend on.",
        ),
        "bench": _BENCH,
    },
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words of the command line; those of this process by default.

    Returns:
        The exit code: 0 the run finished, 1 nothing was produced, 2 wrong usage, 130 interrupted.
    """
    for name in THREAD_VARIABLES:  # workers are the parallelism
        os.environ.setdefault(name, "1")
    try:
        return asked_for(sys.argv[1:] if argv is None else argv).run()
    except KeyboardInterrupt:
        complain("interrupted; the same command continues after what is complete")
        return Exit.INTERRUPTED
    except GmdxError as error:
        complain(f"gmdx: {error}")
        wrong = isinstance(error, UsageError | GripperError)
        return Exit.WRONG_USAGE if wrong else Exit.FAILED
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE


def asked_for(words: Sequence[str], group: Group = COMMANDS, *, prog: str = "gmdx") -> Command:
    """The command that the words of a command line ask for; ends the process after a `--help`."""
    entry = group.entries.get(words[0]) if words else None
    if entry is None:
        _explain(group, words, prog=prog)
    prog = f"{prog} {words[0]}"
    if isinstance(entry, Group):
        return asked_for(words[1:], entry, prog=prog)
    with interrupts_kept():
        command = entry.load()
    return parse(command, words[1:], prog=prog)


def _explain(group: Group, words: Sequence[str], *, prog: str) -> NoReturn:
    """The help of a group, or what is wrong with words that name none of its commands."""
    members = [
        Annotated[make_dataclass(name, ()), subcommand(name, description=entry.summary)]
        for name, entry in group.entries.items()
    ]
    choice: Any = Union[tuple(members)]  # noqa: UP007
    tyro.cli(choice, prog=prog, description=group.summary, args=words)
    raise UsageError(f"{prog} has no command among: {' '.join(words)}")
