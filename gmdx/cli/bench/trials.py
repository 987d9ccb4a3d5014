"""The command `gmdx bench trials`: the speed of engines on the same trials."""

import dataclasses
import json
import textwrap
from typing import Annotated, Any

from rich.box import SIMPLE_HEAVY
from rich.table import Table
from tyro.conf import arg

from gmdx.cli.bench.scenes import prepared_scenes
from gmdx.cli.exits import Exit
from gmdx.cli.options import (
    BenchObjects,
    GripperName,
    Json,
    NameList,
    NumberList,
    name_list,
    number_list,
)
from gmdx.cli.tables import short
from gmdx.cli.terminal import console, following, say
from gmdx.pipeline.config import GenerateConfig
from gmdx.scenes.gripper import DEFAULT_GRIPPER, load_gripper
from gmdx.studies.engines import (
    Machine,
    RunFailure,
    TrialFigures,
    TrialSpeed,
    choose_all,
    refuse_idle_sizes,
    refuse_less_than_one,
    trial_figures,
)
from gmdx.trials.engines import DEFAULT_ENGINE

BY_MEMORY = "(default: by the device's memory)"


@dataclasses.dataclass(frozen=True)
class Trials:
    """Trials and steps a second of every engine, on the same trials of all objects in one run.

    Each engine runs twice: the first run also compiles, the second is timed. All rates are by the
    clock on the wall, since work on a device takes no processor time: let nothing else run
    meanwhile. The processor time that the host spent beside stands in its own column; for MuJoCo
    on one thread it is what the clock would show on an idle machine.

    A trial is about 200 steps. MuJoCo takes about 30 microseconds a step on one core, Warp about 2
    milliseconds where it has no device but the CPU: ask for few grasps there.
    """

    objects: BenchObjects = ("bundled",)
    """what to grasp"""
    engine: NameList = DEFAULT_ENGINE
    """mujoco, warp, bullet; the last column compares each with the first"""
    parallel_trials: Annotated[NumberList, arg(help_behavior_hint=BY_MEMORY)] = ""
    """trials side by side on a device, a row each"""
    grasps: int = 16
    """grasps per object: take enough to fill the largest batch several times"""
    trials: int = GenerateConfig.trials
    """trials per grasp"""
    threads: int = 1
    """of MuJoCo on the CPU: as many as there are cores, to compare a device with all of them"""
    gripper: GripperName = DEFAULT_GRIPPER
    """a shipped gripper, or the description of your own"""
    json: Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Run every engine, and show what it took."""
        engines, gripper = name_list(self.engine), load_gripper(self.gripper)
        sizes = number_list(self.parallel_trials, option="--parallel-trials")
        refuse_less_than_one(grasps=self.grasps, trials=self.trials, threads=self.threads)
        refuse_idle_sizes(choose_all(engines), sizes)  # before any object is prepared
        scenes = prepared_scenes(self.objects)
        with following("trials", things="engines") as show:
            speed = trial_figures(
                scenes,
                grasps=self.grasps,
                gripper=gripper,
                trials=self.trials,
                engines=engines,
                parallel_trials=sizes,
                threads=self.threads,
                isolated=True,
                on_progress=show,
            )
        if self.json:
            rows = [_with_rates(row) for row in speed.figures]
            say(json.dumps(dataclasses.asdict(speed) | {"figures": rows}, indent=1))
        else:
            show_speed(speed)
        return Exit.FAILED if speed.failures else Exit.DONE


def _with_rates(row: TrialFigures) -> dict[str, Any]:
    """A row with what follows from it."""
    rates = ("trials_per_second", "steps_per_second", "step_microseconds", "step_share")
    return dataclasses.asdict(row) | {name: getattr(row, name) for name in rates}


_SPEED_NOTES = """\
us a step: on the clock, inside the engine's step, for one step of one trial
host ms: processor time of this process for a trial, all threads together
compiled: programs compiled in the first run + found on disk; in the timed run, which should be 0
device MB: the most held on one device; each row has a process of its own"""


def show_speed(speed: TrialSpeed) -> None:
    """One table of at most 100 columns, and what it ran on."""
    title = f"gmdx bench trials ({len(speed.objects)} objects, {speed.grasps} grasps)"
    table = Table(title=title, box=SIMPLE_HEAVY, collapse_padding=True, pad_edge=False)
    table.add_column("engine", no_wrap=True)
    columns = (
        "batch", "trials\na second", "steps a\nsecond", "us a\nstep", "host\nms", "first\nrun s",
        "compiled", "device\nMB", "suc-\ncess", "times\nfirst",
    )  # fmt: skip
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in speed.figures:
        table.add_row(
            row.engine,
            "" if row.parallel_trials is None else str(row.parallel_trials),
            short(row.trials_per_second),
            short(row.steps_per_second),
            short(row.step_microseconds),
            short(1e3 * row.processor_seconds / row.trials),
            short(row.first_seconds),
            "" if row.compiled is None else f"{row.compiled}+{row.cached}; {row.compiled_again}",
            "" if row.device_bytes is None else short(row.device_bytes / 1e6),
            f"{100 * row.success:.0f} %",
            "" if row.ratio is None else short(row.ratio),
        )
    console().print(table)
    say_failures(speed.failures)
    for row in speed.figures:
        if row.failed:
            say(f"{row.engine}: {row.failed} of {row.trials} trials diverged or overflowed")
        if row.parallel_trials is not None and row.trials < 2 * row.parallel_trials:
            say(f"{row.engine} x {row.parallel_trials}: filled at most once by {row.trials} trials")
    say(_SPEED_NOTES)
    for name, version in dict.fromkeys((row.engine, row.version) for row in speed.figures):
        threads = next(row.threads for row in speed.figures if row.engine == name)
        used = "" if threads is None else f", {threads} thread{'s' if threads > 1 else ''}"
        say(f"{name}: {version}{used}")
    say_machine(speed.machine)


def say_failures(failures: tuple[RunFailure, ...]) -> None:
    """Engines that failed, a line each."""
    for failure in failures:
        say(f"{failure.label} failed: {failure.error}")


def say_machine(machine: Machine) -> None:
    """What the figures were measured on."""
    versions = ", ".join(f"{name} {number}" for name, number in machine.packages.items())
    say(f"{machine.processor}, {machine.cores} cores, {machine.system}; Python {machine.python}")
    say(textwrap.fill(versions, width=100))
