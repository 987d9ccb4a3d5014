"""The same seeded trials in C MuJoCo and in other engines, and how far they agree."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gmdx.errors import GmdxError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.progress import Follower, OnProgress
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.studies.engines.machine import machine
from gmdx.studies.engines.parity import LIMITS, Measured, compare_trials, measure
from gmdx.studies.engines.parity_result import EngineParity, ParityFigures
from gmdx.studies.engines.runs import (
    RunFailure,
    choose_all,
    refuse_idle_sizes,
    refuse_less_than_one,
    run_apart,
)
from gmdx.trials.protocol import TRIALS, TrialConfig
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials

_LOG = logging.getLogger("gmdx")

REFERENCE = "mujoco"
NUDGE = 1e-6  # m, that objects are moved by to see what a small change comes to


@dataclass(frozen=True)
class _Task:
    """Trials to run in one call, on an engine, and how."""

    engine: str
    threads: int
    parallel_trials: int | None
    scenes: Sequence[Scene]
    grasps: Sequence[PlanarGrasp]
    gripper: Gripper
    repeats: int  # trials of each grasp
    config: TrialConfig

    @property
    def trials(self) -> int:
        return sum(map(len, self.grasps)) * self.repeats


def _run(task: _Task) -> list[TrialResults]:
    _LOG.info("%s: %d trials", task.engine, task.trials)
    return run_trials(
        task.scenes,
        task.grasps,
        task.engine,
        trials=task.repeats,
        gripper=task.gripper,
        config=task.config,
        threads=task.threads,
        parallel_trials=task.parallel_trials,
    )


def parity_figures(
    scenes: Sequence[Scene],
    *,
    engines: Sequence[str],
    grasps: int,
    gripper: Gripper,
    trials: int = TRIALS,
    config: TrialConfig | None = None,
    threads: int = 1,
    parallel_trials: int | None = None,
    floor: bool = True,
    isolated: bool = False,
    on_progress: OnProgress | None = None,
) -> ParityFigures:
    """Run the same trials in C MuJoCo and in each engine, all objects in one run, and compare.

    An engine that fails is named in what comes back, and the others go on.

    Args:
        scenes: Objects at rest.
        engines: Names; those of `LIMITS` are held to them.
        grasps: How many of each object, each with `trials` trials.
        gripper: What grasps.
        trials: Of each grasp.
        config: Of the trials.
        threads: Of MuJoCo on the CPU; no result depends on it.
        parallel_trials: Side by side on a device; no result may depend on it.
        floor: Also run the reference with every object moved by `NUDGE`, to see how much of a
            difference says nothing about an engine.
        isolated: Each engine in a process of its own; False stays in this process.
        on_progress: Called at the start and after each engine.

    Raises:
        UsageError: An engine is not known or not installed, or a number is not positive.
        GmdxError: The grasps could not be sampled, or the reference could not be run.
    """
    refuse_less_than_one(
        grasps=grasps,
        trials=trials,
        threads=threads,
        parallel_trials=1 if parallel_trials is None else parallel_trials,
    )
    chosen = choose_all(engines)
    refuse_idle_sizes(chosen, [] if parallel_trials is None else [parallel_trials])
    config = TrialConfig() if config is None else config
    batches = [sample_grasps(scene, grasps, gripper=gripper) for scene in scenes]
    follower = Follower(1 + floor + len(chosen), on_progress)

    def run(name: str, at: Sequence[Scene], label: str) -> Measured | RunFailure:
        task = _Task(name, threads, parallel_trials, at, batches, gripper, trials, config)
        results = run_apart(_run, task, label=label, isolated=isolated)
        if isinstance(results, RunFailure):
            follower.finished(label)
            return results
        follower.finished(label, count=task.trials)
        return measure(at, batches, results)

    reference = run(REFERENCE, scenes, REFERENCE)
    if isinstance(reference, RunFailure):
        raise GmdxError(f"the reference {REFERENCE} failed: {reference.error}")
    found: list[EngineParity] = []
    failures: list[RunFailure] = []
    nudged: EngineParity | None = None
    if floor:
        label = f"{REFERENCE}, nudged"
        other = run(REFERENCE, [_nudged(scene) for scene in scenes], label)
        if isinstance(other, RunFailure):
            failures.append(other)
        else:
            nudged = compare_trials(reference, other, engine=label)
    for name in chosen:
        other = run(name, scenes, name)
        if isinstance(other, RunFailure):
            failures.append(other)
        else:
            found.append(compare_trials(reference, other, engine=name, limits=LIMITS.get(name)))
    return ParityFigures(
        machine=machine(),
        reference=reference.version,
        objects=reference.objects,
        grasps=len(reference.object),
        nudge=NUDGE,
        floor=nudged,
        parities=tuple(found),
        failures=tuple(failures),
    )


def _nudged(scene: Scene) -> Scene:
    """The object a little to one side, under the same grasps."""
    return replace(scene, position=scene.position + NUDGE * np.array([0.6, 0.8, 0.0]))
