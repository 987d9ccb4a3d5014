"""How fast trials are on each engine: those of all objects in one run, one engine after the other.

Rates are by the clock on the wall for every engine: work on a device takes no processor time, and
a ratio of two kinds of time says nothing. The host's processor seconds stand beside them.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.progress import Follower, OnProgress
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.studies.engines.machine import Machine, compilations, machine, peak_device_memory
from gmdx.studies.engines.runs import (
    RunFailure,
    choose_all,
    refuse_idle_sizes,
    refuse_less_than_one,
    run_apart,
)
from gmdx.trials.engines import DEFAULT_ENGINE, ENGINES, Engine, open_engine
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TRIALS, TrialConfig
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials

_LOG = logging.getLogger("gmdx")


@dataclass(frozen=True)
class TrialFigures:
    """What the trials took on one engine, run again after what is paid only once."""

    engine: str
    parallel_trials: int | None  # side by side on a device; None: by its memory
    threads: int | None  # of MuJoCo on the CPU
    version: str  # with the device, as datasets record it
    trials: int
    steps: int  # of the engine, over all trials
    first_seconds: float  # the very first run here, compiling included
    compiled: int | None  # programs for the device in that run; None: the engine has none
    cached: int | None  # such programs that an earlier process had compiled
    compiled_again: int | None  # compiled or loaded in the run that the other figures are of
    seconds: float  # of that run, on the clock
    processor_seconds: float  # of the same, over all threads of the host
    step_seconds: float  # inside the engine's step, on the clock
    device_bytes: int | None  # the most held on one device until then; None: no device, or unknown
    success: float  # share of trials
    failed: int  # trials that diverged or overflowed
    ratio: float | None = None  # of trials a second to the first engine's; None: that failed

    @property
    def trials_per_second(self) -> float:
        """On the clock."""
        return self.trials / self.seconds

    @property
    def steps_per_second(self) -> float:
        """Steps of single trials, on the clock."""
        return self.steps / self.seconds

    @property
    def step_microseconds(self) -> float:
        """Of the engine's step, a step and trial."""
        return 1e6 * self.step_seconds / max(self.steps, 1)

    @property
    def step_share(self) -> float:
        """Part of the time that is inside the engine's step."""
        return self.step_seconds / self.seconds


@dataclass(frozen=True)
class TrialSpeed:
    """Every engine on the same trials."""

    machine: Machine
    objects: tuple[str, ...]
    grasps: int  # over all objects
    figures: tuple[TrialFigures, ...]
    failures: tuple[RunFailure, ...]


@dataclass(frozen=True)
class _Case:
    """Trials to run in one call, on an engine, and how."""

    engine: str
    parallel_trials: int | None
    threads: int
    scenes: Sequence[Scene]
    grasps: Sequence[PlanarGrasp]
    gripper: Gripper
    repeats: int  # trials of each grasp
    config: TrialConfig

    @property
    def label(self) -> str:
        size = self.parallel_trials
        return self.engine if size is None else f"{self.engine} x {size}"

    @property
    def trials(self) -> int:
        return sum(map(len, self.grasps)) * self.repeats

    def open(self) -> Engine:
        return open_engine(self.engine, threads=self.threads, parallel_trials=self.parallel_trials)

    def run(self, engine: Engine) -> list[TrialResults]:
        return run_trials(
            self.scenes,
            self.grasps,
            engine,
            trials=self.repeats,
            gripper=self.gripper,
            config=self.config,
        )


def trial_figures(
    scenes: Sequence[Scene],
    *,
    grasps: int,
    gripper: Gripper,
    trials: int = TRIALS,
    config: TrialConfig | None = None,
    engines: Sequence[str] = (DEFAULT_ENGINE,),
    parallel_trials: Sequence[int] = (),
    threads: int = 1,
    isolated: bool = False,
    on_progress: OnProgress | None = None,
) -> TrialSpeed:
    """Run the same trials twice on each engine, and time the second run.

    An engine that fails is named in what comes back, and the others go on.

    Args:
        scenes: Objects at rest, whose trials run in one call.
        grasps: How many of each object, each with `trials` trials.
        gripper: What grasps.
        trials: Of each grasp.
        config: Of the trials.
        engines: Names; the first is what the others are compared with.
        parallel_trials: Side by side on a device, a row of figures each, the smallest first; none:
            what the device's memory allows.
        threads: Of MuJoCo on the CPU.
        isolated: Each row in a process of its own, so that what one engine compiled or holds in
            memory is no other's; False stays in this process.
        on_progress: Called at the start and after each row.

    Raises:
        UsageError: An engine is not known or not installed, a number is not positive, or there
            are parallel trials but no engine that takes them.
        GmdxError: The grasps could not be sampled.
    """
    refuse_less_than_one(
        grasps=grasps,
        trials=trials,
        threads=threads,
        parallel_trials=min(parallel_trials, default=1),
    )
    chosen = choose_all(engines)
    refuse_idle_sizes(chosen, parallel_trials)
    batches = [sample_grasps(scene, grasps, gripper=gripper) for scene in scenes]
    config = TrialConfig() if config is None else config
    sizes: list[int | None] = [*sorted(set(parallel_trials))] if parallel_trials else [None]
    cases = [
        _Case(engine, size, threads, scenes, batches, gripper, trials, config)
        for engine in chosen
        for size in (sizes if ENGINES[engine].parallel else [None])
    ]
    follower = Follower(len(cases), on_progress)
    found: list[TrialFigures] = []
    failures: list[RunFailure] = []
    first_rate: float | None = None
    for case in cases:
        figures = run_apart(_measure, case, label=case.label, isolated=isolated)
        if isinstance(figures, RunFailure):
            failures.append(figures)
            follower.finished(case.label)
            continue
        if case is cases[0]:
            first_rate = figures.trials_per_second
        if first_rate is not None:
            figures = replace(figures, ratio=figures.trials_per_second / first_rate)
        found.append(figures)
        follower.finished(case.label, count=2 * case.trials)
    return TrialSpeed(
        machine=machine(),
        objects=tuple(scene.object.object_id for scene in scenes),
        grasps=sum(map(len, batches)),
        figures=tuple(found),
        failures=tuple(failures),
    )


def _measure(case: _Case) -> TrialFigures:
    """Two runs on one engine."""
    before = compilations(case.engine)
    engine = case.open()
    _LOG.info("%s: %d trials, the first time", case.label, case.trials)
    start = time.perf_counter()
    case.run(engine)
    first_seconds = time.perf_counter() - start
    _LOG.info("%s: that took %.1f s; the same again, timed", case.label, first_seconds)

    between = compilations(case.engine)
    start, processor_start = time.perf_counter(), time.process_time()
    results = case.run(engine)
    seconds, processor_seconds = time.perf_counter() - start, time.process_time() - processor_start

    after = compilations(case.engine)
    made = again = None
    if before is not None and between is not None and after is not None:
        made, again = between.since(before), after.since(between)
    outcomes = np.concatenate([result.outcome.ravel() for result in results])
    return TrialFigures(
        engine=case.engine,
        parallel_trials=case.parallel_trials,
        threads=case.threads if case.engine == DEFAULT_ENGINE else None,
        version=results[0].engine,
        trials=len(outcomes),
        steps=sum(result.steps for result in results),
        first_seconds=first_seconds,
        compiled=None if made is None else made.compiled,
        cached=None if made is None else made.cached,
        compiled_again=None if again is None else again.compiled + again.cached,
        seconds=seconds,
        processor_seconds=processor_seconds,
        step_seconds=sum(result.step_seconds for result in results),
        device_bytes=peak_device_memory(case.engine),
        success=float((outcomes == Outcome.SUCCESS).mean()),
        failed=int(Outcome.is_failure(outcomes).sum()),
    )
