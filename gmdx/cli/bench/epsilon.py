"""The commands `gmdx bench epsilon` and `gmdx bench patches`: ways to compute grasp quality."""

import dataclasses
import json

from rich.table import Table

from gmdx.cli.bench.scenes import fresh_scenes
from gmdx.cli.exits import Exit
from gmdx.cli.options import BenchObjects, GripperName, Json
from gmdx.cli.tables import show_records
from gmdx.cli.terminal import console, say
from gmdx.errors import UsageError
from gmdx.scenes.gripper import DEFAULT_GRIPPER, load_gripper
from gmdx.studies.epsilon import (
    EpsilonFigures,
    EpsilonStudyConfig,
    MethodFigures,
    epsilon_figures,
    patch_figures,
)


@dataclasses.dataclass(frozen=True)
class Epsilon:
    """Epsilon by every method on the same random grasps: processor time and error."""

    grasps: int = EpsilonStudyConfig.pairs
    """pairs of contacts, and a fifth as many grasps with eight; slow methods take the first few,
    while the bulk kernel, which computes in chunks, shows its speed from several hundred on"""
    json: Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Run every method once, one after the other."""
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
            return Exit.DONE
        _show_epsilon(figures)
        return Exit.DONE


@dataclasses.dataclass(frozen=True)
class Patches:
    """Qualities 15 and 23 from all contacts of a pad, against the pair of their means."""

    objects: BenchObjects = ("bundled",)
    """what to grasp"""
    grasps: int = 24
    """grasps per object"""
    gripper: GripperName = DEFAULT_GRIPPER
    """a shipped gripper, or the description of your own"""
    json: Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Compute both on every object."""
        gripper = load_gripper(self.gripper)
        found = patch_figures(fresh_scenes(self.objects), grasps=self.grasps, gripper=gripper)
        show_records("gmdx bench patches", found, as_json=self.json, upright=True)
        return Exit.DONE


_EPSILON_NOTES = """\
limit: of the bulk kernel it holds for the value; in a dataset the proof comes with it
error: relative to the certified value; of certified rows, the proved gap between their bounds
linearised cones: torsion as two wrenches at full normal force; always too low
as in Dex-Net: torsion without any normal force; too low or too high
limit surface: points on each contact's ellipsoid of force and torsion; always too low"""


def _show_epsilon(figures: EpsilonFigures) -> None:
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


def _kept(row: MethodFigures) -> str:
    """The limit, and whether the method keeps it."""
    if row.limit is None:
        return ""
    return f"{row.limit:g}: {'pass' if row.within else 'FAIL'}"
