"""The command `gmdx`. What is slow to import is imported by the command that needs it."""

import contextlib
import dataclasses
import json
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, OmitSubcommandPrefixes, Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from gmdx.config import as_toml, load_toml, merge
from gmdx.errors import GmdxError, UsageError
from gmdx.workers import THREAD_VARIABLES, available_cores

if TYPE_CHECKING:
    from gmdx.pipeline import GenerateConfig, Progress, Summary

DONE, NOTHING_PRODUCED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130

_DESCRIPTION = """\
Annotated planar-grasp datasets from object meshes.

A first dataset, from the objects that come along:

  gmdx generate bundled --out runs/first
  gmdx inspect runs/first
"""

_logger = logging.getLogger("gmdx")


def _whole_number(default: str) -> Any:
    """An integer flag that is None where it is not given, and says what holds then."""
    return (
        PrimitiveConstructorSpec(
            nargs=1,
            metavar="INT",
            instance_from_str=lambda words: int(words[0]),
            is_instance=lambda value: isinstance(value, int | None),
            str_from_instance=lambda value: [str(value)],
        ),
        arg(help_behavior_hint=f"(default: {default})"),
    )


@dataclasses.dataclass(frozen=True)
class Generate:
    """Annotate objects with grasps, trials and metrics. Run it again to continue.

    OBJECTS are any mix of: bundled, mesh files, folders, globs, pybullet:random_urdfs[:N].
    """

    objects: Annotated[tuple[str, ...], Positional, arg(metavar="OBJECTS...")] = ()
    """what to annotate"""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """folder of the dataset"""
    grasps: Annotated[int | None, *_whole_number("64")] = None
    """grasps per scene"""
    scenes: Annotated[int | None, *_whole_number("2")] = None
    """scenes per object"""
    trials: Annotated[int | None, *_whole_number("5")] = None
    """simulated trials per grasp"""
    seed: Annotated[int | None, *_whole_number("0")] = None
    """of every random number"""
    gripper: Annotated[
        str | None, arg(metavar="NAME|FILE", help_behavior_hint="(default: parallel_jaw)")
    ] = None
    """a shipped gripper, or a description file"""
    workers: Annotated[int | None, *_whole_number("one per core")] = None
    """processes"""
    config: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(optional)")] = None
    """TOML file with further settings; flags win over it"""
    cache: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: ~/.cache/gmdx)")] = None  # fmt: skip  # noqa: E501
    """folder of prepared objects"""
    print_config: FlagCreatePairsOff[bool] = False
    """print all settings as a TOML file to edit, and stop"""

    def run(self) -> int:
        """Generate the dataset, with a progress bar on a terminal."""
        from gmdx.pipeline import generate

        config = self.settings()
        if self.print_config:
            _say(as_toml(config))
            return DONE
        if not self.objects:
            raise UsageError("say what to annotate, for example: gmdx generate bundled --out DIR")
        if self.out is None:
            raise UsageError("say where the dataset goes: --out DIR")
        with _progress() as on_progress:
            summary = generate(self.objects, self.out, config, on_progress=on_progress)
        _say(_last_line(summary))
        return DONE if summary.counts["objects"] else NOTHING_PRODUCED

    def settings(self) -> "GenerateConfig":
        """The defaults, the configuration file over them, and the flags over both."""
        from gmdx.pipeline import GenerateConfig

        config = GenerateConfig(workers=available_cores(), cache=_cache_folder())
        if self.config is not None:
            config = merge(config, load_toml(self.config))
        names = ("grasps", "scenes", "trials", "seed", "gripper", "workers", "cache")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return merge(config, given)


@dataclasses.dataclass(frozen=True)
class Inspect:
    """Show what a dataset holds: counts, success, outcomes, missing values, failures, cost."""

    dataset: Annotated[Path, Positional, arg(metavar="DIR")]
    """folder of the dataset"""

    def run(self) -> int:
        """Print the tables."""
        from gmdx.dataset.inspect import overview, tables
        from gmdx.dataset.read import read_dataset

        console = _console()
        for table in tables(overview(read_dataset(self.dataset))):
            console.print(table)
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
        _console().print(table)
        return DONE


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words of the command line; those of this process by default.

    Returns:
        The exit code: 0 the run finished, 1 nothing was produced, 2 wrong usage, 130 interrupted.
    """
    for name in THREAD_VARIABLES:  # workers are the parallelism, and results do not depend on it
        os.environ.setdefault(name, "1")
    try:
        return _parsed(argv).run()
    except KeyboardInterrupt:
        _complain("interrupted; the same command continues after what is complete")
        return INTERRUPTED
    except GmdxError as error:
        _complain(f"gmdx: {error}")
        return WRONG_USAGE if isinstance(error, UsageError) else NOTHING_PRODUCED
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
