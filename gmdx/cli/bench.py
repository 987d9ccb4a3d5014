"""The commands `gmdx bench ...`: the figures of `studies.throughput` on objects of choice."""

import dataclasses
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Table
from tyro.conf import FlagCreatePairsOff, Positional, arg

from gmdx.cli.terminal import console, following, say
from gmdx.errors import UsageError

if TYPE_CHECKING:
    from gmdx.scenes.scene import Scene
    from gmdx.studies.epsilon import EpsilonFigures, MethodFigures

_Objects = Annotated[tuple[str, ...], Positional, arg(metavar="OBJECTS...")]
_Gripper = Annotated[str, arg(metavar="NAME|FILE")]
_Json = FlagCreatePairsOff[bool]


@dataclasses.dataclass(frozen=True)
class Pipeline:
    """Seconds per grasp of the whole pipeline by stage, and what more workers bring."""

    objects: _Objects = ("bundled",)
    """what to annotate"""
    grasps: int = 64
    """grasps per scene"""
    scenes: int = 2
    """scenes per object"""
    workers: Annotated[str, arg(metavar="N,N,...")] = "1"
    """numbers of processes to compare; the first run gives the figures by stage"""
    json: _Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Prepare the objects once, run the rest with each number of workers, and show both."""
        from gmdx.dataset.read import read_dataset
        from gmdx.pipeline.generate import GenerateConfig, generate
        from gmdx.studies.throughput import (
            peak_megabytes,
            pipeline_figures,
            rows,
            worker_figures,
        )

        counts = numbers(self.workers, option="--workers")
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder) / "cache"
            config = GenerateConfig(grasps=self.grasps, scenes=self.scenes, cache=cache)

            def run(workers: int) -> None:
                with following("grasps") as show:
                    chosen = dataclasses.replace(config, workers=workers)
                    out = Path(folder) / f"workers{workers}"
                    generate(self.objects, out, chosen, on_progress=show)

            first = dataclasses.replace(config, grasps=1, scenes=1, workers=max(counts))
            with following("grasps") as show:
                generate(self.objects, Path(folder) / "first", first, on_progress=show)
            compared = worker_figures(run, counts)
            figures = pipeline_figures(read_dataset(Path(folder) / f"workers{counts[0]}"))
            prepared = pipeline_figures(read_dataset(Path(folder) / "first")).prepare_seconds
        figures = dataclasses.replace(figures, prepare_seconds=prepared)
        if self.json:
            runs = [dataclasses.asdict(run) for run in compared]
            values = {
                **dataclasses.asdict(figures),
                "total": figures.total,
                "workers": runs,
                "peak_megabytes": peak_megabytes(),
            }
            say(json.dumps(values, indent=1))
            return 0
        table = Table("stage", "processor time", title="gmdx bench pipeline")
        for name, value in rows(figures):
            table.add_row(name, value)
        for item in compared:
            what = f"{item.wall_seconds:.1f} s on the clock, {item.ratio:.2f} times the first"
            table.add_row(f"{item.workers} workers", what)
        table.add_row("memory of the largest process", f"{peak_megabytes():.0f} MB at the most")
        console().print(table)
        return 0


@dataclasses.dataclass(frozen=True)
class Depth:
    """Depth images per second."""

    objects: _Objects = ("bundled",)
    """what to look at"""
    images: int = 16
    """images per object"""
    json: _Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Render every object several times."""
        from gmdx.studies.throughput import depth_figures

        found = [depth_figures(scene, images=self.images) for scene in _scenes(self.objects)]
        _show("gmdx bench depth (640 x 480)", found, as_json=self.json)
        return 0


@dataclasses.dataclass(frozen=True)
class Epsilon:
    """Epsilon by every method on the same random grasps: processor time and error."""

    grasps: int = 1000
    """pairs of contacts, and a fifth as many grasps with eight; slow methods take the first few,
    while the bulk kernel, which computes in chunks, shows its speed from several hundred on"""
    json: _Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Run every method once, one after the other."""
        from gmdx.studies.epsilon import EpsilonStudyConfig, epsilon_figures

        if self.grasps < 1:
            raise UsageError(f"--grasps must be at least 1, not {self.grasps}")
        config = EpsilonStudyConfig(pairs=self.grasps, patches=-(-self.grasps // 5))
        figures = epsilon_figures(config)
        if self.json:
            rows = [
                {**dataclasses.asdict(row), "per_second": row.per_second, "within": row.within}
                for row in figures.methods
            ]
            say(json.dumps({**dataclasses.asdict(figures), "methods": rows}, indent=1))
            return 0
        _show_epsilon(figures)
        return 0


@dataclasses.dataclass(frozen=True)
class Patches:
    """Qualities 15 and 23 from all contacts of a pad, against the pair of their means."""

    objects: _Objects = ("bundled",)
    """what to grasp"""
    grasps: int = 24
    """grasps per object"""
    gripper: _Gripper = "parallel_jaw"
    """a shipped gripper, or the description of your own"""
    json: _Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Compute both on every object."""
        from gmdx.scenes.gripper import load_gripper
        from gmdx.studies.epsilon import patch_figures

        gripper = load_gripper(self.gripper)
        found = patch_figures(_scenes(self.objects), grasps=self.grasps, gripper=gripper)
        _show("gmdx bench patches", found, as_json=self.json, upright=True)
        return 0


def numbers(text: str, *, option: str) -> list[int]:
    """`1,2` as numbers from 1 on.

    Raises:
        UsageError: Naming the option.
    """
    try:
        found = [int(word) for word in text.split(",")]
    except ValueError as error:
        raise UsageError(f"{option} takes numbers such as 1,2, not {text!r}") from error
    if min(found) < 1:
        raise UsageError(f"{option} takes numbers from 1 on, not {text!r}")
    return found


def _scenes(objects: tuple[str, ...]) -> Iterator["Scene"]:
    """One scene of each object, which is prepared without a cache."""
    from gmdx.objects.prepare import PrepareConfig, prepare
    from gmdx.objects.sources import resolve
    from gmdx.scenes.settle import settle

    for source in resolve(list(objects)):
        yield settle(prepare(source, config=PrepareConfig(), cache=None))


def _show(title: str, found: list[Any], *, as_json: bool, upright: bool = False) -> None:
    """Records of figures as a table, a row each (upright: a column each), or as JSON."""
    values = [dataclasses.asdict(item) for item in found]
    if as_json:
        say(json.dumps(values, indent=1))
        return
    rows = [[name.replace("_", " ") for name in values[0]]]
    rows += [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()]
             for row in values]  # fmt: skip
    if upright:
        rows = [list(row) for row in zip(*rows, strict=True)]
    table = Table(title=title)
    for column, name in enumerate(rows[0]):
        table.add_column(name, justify="left" if upright and column == 0 else "right")
    for row in rows[1:]:
        table.add_row(*row)
    console().print(table)


_EPSILON_NOTES = """\
limit: of the bulk kernel it holds for the value; in a dataset the proof comes with it
error: relative to the certified value; of certified rows, the proved gap between their bounds
linearised cones: torsion as two wrenches at full normal force; always too low
as in Dex-Net: torsion without any normal force; too low or too high
limit surface: points on each contact's ellipsoid of force and torsion; always too low"""


def _show_epsilon(figures: "EpsilonFigures") -> None:
    """The comparison as one table of at most 100 columns, and what its words mean."""
    table = Table(title=f"gmdx bench epsilon (one core, seed {figures.seed})")
    table.add_column("method", no_wrap=True)
    columns = ("con-\ntacts", "grasps", "ms a\ngrasp", "grasps\na second", "error %\nmedian",
               "error %\nworst")  # fmt: skip
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("limit\nms", no_wrap=True)
    contacts = figures.methods[0].contacts
    for row in figures.methods:
        if row.contacts != contacts:
            table.add_section()
            contacts = row.contacts
        table.add_row(
            row.method,
            str(row.contacts),
            str(row.grasps),
            f"{row.milliseconds:.3g}" if row.milliseconds >= 1 else f"{row.milliseconds:.3f}",
            f"{row.per_second:,.0f}" if row.per_second >= 10 else f"{row.per_second:.1f}",
            _percent(row.error_median, proved=row.proved),
            _percent(row.error_worst, proved=row.proved),
            _kept(row),
        )
    console().print(table)
    for row in figures.methods:
        if row.first_call_seconds is not None:
            say(f"{row.method}: the first call took {row.first_call_seconds:.2f} s")
    say(_EPSILON_NOTES)
    say(
        f"friction {figures.friction:g}, torsion {1e3 * figures.torsion:.3g} mm, "
        f"torques divided by {1e3 * figures.torque_scale:.3g} mm"
    )


def _percent(error: float, *, proved: bool) -> str:
    """A relative error in %, or the gap that is proved to hold it."""
    text = f"{100 * error:.1f}" if abs(error) >= 1e-3 or error == 0 else f"{100 * error:.0e}"
    if proved:
        return f"<= {text}"
    return text if text.startswith("-") else f"+{text}"


def _kept(row: "MethodFigures") -> str:
    """The limit, and whether the method keeps it."""
    if row.limit is None:
        return ""
    return f"{row.limit:g}: {'pass' if row.within else 'FAIL'}"
