"""The command `gmdx bench parity`: how far engines agree with C MuJoCo on the same trials."""

import dataclasses
import json
from typing import Annotated

from rich.table import Table
from tyro.conf import arg

from gmdx.cli.bench.scenes import prepared_scenes
from gmdx.cli.bench.trials import BY_MEMORY, say_failures, say_machine
from gmdx.cli.exits import Exit
from gmdx.cli.options import BenchObjects, GripperName, Json, NameList, name_list, number_list
from gmdx.cli.tables import short
from gmdx.cli.terminal import console, following, say
from gmdx.errors import UsageError
from gmdx.pipeline.config import GenerateConfig
from gmdx.scenes.gripper import DEFAULT_GRIPPER, load_gripper
from gmdx.studies.engines import (
    EngineParity,
    MetricParity,
    ParityFigures,
    choose_all,
    parity_figures,
    refuse_idle_sizes,
    refuse_less_than_one,
)


@dataclasses.dataclass(frozen=True)
class Parity:
    """How far engines agree with C MuJoCo on the same seeded trials: outcomes and metrics.

    Differences are absolute, over the grasps for which both engines have the metric. Warp is held
    to limits; PyBullet, which is other physics, is only shown.
    """

    objects: BenchObjects = ("bundled",)
    """what to grasp"""
    engine: NameList = "warp"
    """engines to compare with C MuJoCo: warp, bullet"""
    grasps: int = 16
    """grasps per object"""
    trials: int = GenerateConfig.trials
    """trials per grasp, of which the first is pushed and gives the metrics"""
    parallel_trials: Annotated[str, arg(metavar="N", help_behavior_hint=BY_MEMORY)] = ""
    """trials side by side on a device; no result may depend on it"""
    threads: int = 1
    """of MuJoCo on the CPU"""
    floor: bool = True
    """also compare MuJoCo with itself, every object moved by a micrometre"""
    gripper: GripperName = DEFAULT_GRIPPER
    """a shipped gripper, or the description of your own"""
    json: Json = False
    """print JSON instead of tables"""

    def run(self) -> int:
        """Run every engine, and show how it differs."""
        engines, gripper = name_list(self.engine), load_gripper(self.gripper)
        sizes = number_list(self.parallel_trials, option="--parallel-trials")
        if len(sizes) > 1:
            raise UsageError(f"--parallel-trials takes one number here, not {self.parallel_trials}")
        refuse_less_than_one(grasps=self.grasps, trials=self.trials, threads=self.threads)
        refuse_idle_sizes(choose_all(engines), sizes)  # before any object is prepared
        scenes = prepared_scenes(self.objects)
        with following("trials", things="engines") as show:
            figures = parity_figures(
                scenes,
                engines=engines,
                grasps=self.grasps,
                gripper=gripper,
                trials=self.trials,
                threads=self.threads,
                floor=self.floor,
                parallel_trials=sizes[0] if sizes else None,
                isolated=True,
                on_progress=show,
            )
        if self.json:
            say(json.dumps(figures.as_json(), indent=1))
        else:
            show_parity(figures)
        missed = any(parity.passed is False for parity in figures.parities)
        return Exit.FAILED if figures.failures or missed else Exit.DONE


_PARITY_NOTES = """\
differences are absolute: median, 95th percentile and largest over the grasps that have both
agreement in brackets: Wilson's 95 % interval, each grasp taken for one thing
force, relative: of grasps that are pushed out, or would be, in both engines
X_norm columns are X divided by the object's bound_l; they are in the JSON"""


def show_parity(figures: ParityFigures) -> None:
    """For each engine a table of at most 100 columns, and one of the outcomes that differ."""
    for parity in [*([] if figures.floor is None else [figures.floor]), *figures.parities]:
        console().print(_parity_table(parity))
        if parity.disagreements:
            table = Table(
                "in mujoco", f"in {parity.engine}", "trials", title="outcomes that differ"
            )
            for row in parity.disagreements:
                table.add_row(row.reference, row.other, str(row.trials))
            console().print(table)
        worst = sorted(parity.objects, key=lambda one: one.agreement)
        differing = [one for one in worst if one.agreement < 1]
        if differing:
            words = ", ".join(f"{one.object_id} {100 * one.agreement:.1f}" for one in differing[:4])
            say(f"least agreement by object, %: {words}")
        if parity.passed is not None:
            say(f"{parity.engine}: {'pass' if parity.passed else 'FAIL'}")
    say_failures(figures.failures)
    say(_PARITY_NOTES)
    if figures.floor is not None:
        say(f"nudged: every object moved by {figures.nudge:g} m; what that changes, chance changes")
    for parity in figures.parities:
        say(f"{parity.engine}: {parity.version}")
    say(f"reference: {figures.reference}")
    say_machine(figures.machine)


def _parity_table(parity: EngineParity) -> Table:
    title = f"gmdx bench parity: {parity.engine} ({parity.grasps} grasps, {parity.trials} trials)"
    table = Table(title=title)
    table.add_column("what", no_wrap=True)
    for name in ("unit", "pairs", "median", "95 %", "largest"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("limit", no_wrap=True)
    share = parity.agreement
    table.add_row(
        "outcomes that agree",
        "%",
        str(parity.trials),
        f"{100 * share.value:.2f}",
        f"[{100 * share.low:.1f},",
        f"{100 * share.high:.1f}]",
        "" if parity.limits is None
        else _verdict(f">= {100 * parity.limits.outcomes:g}", parity.agrees),
    )  # fmt: skip
    first, second = (100 * share for share in parity.success)
    table.add_row(
        "success, mujoco / this", "%", str(parity.trials), f"{first:.1f}", f"{second:.1f}"
    )
    table.add_section()
    shown = [row for row in parity.metrics if not row.metric.endswith("_norm")]
    for row in [*shown, parity.force]:
        table.add_row(
            row.metric,
            row.unit,
            str(row.pairs),
            *(short(value) for value in (row.median, row.p95, row.worst)),
            "" if row.limit is None else _verdict(f"< {row.limit:g}", row.within, row),
        )
    return table


def _verdict(limit: str, within: bool | None, row: MetricParity | None = None) -> str:
    if row is not None and row.pairs == 0:
        return f"{limit}: FAIL, no data"
    return f"{limit}: {'pass' if within else 'FAIL'}"
