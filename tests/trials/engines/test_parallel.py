"""What the engine of trials side by side does with batches, whoever computes them."""

import gc
import logging
import weakref
from collections.abc import Callable, Sequence

import numpy as np
import pytest

pytest.importorskip("warp", reason="the extra gmdx[warp] is not installed")
pytest.importorskip("mujoco.mjx", reason="the extra gmdx[warp] is not installed")

from gmdx.errors import ConfigError, DeviceMemoryError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.machine.devices import cuda_devices
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.engines.parallel import Cancelled, ParallelEngine, Worlds
from gmdx.trials.engines.registry import choose, open_engine
from gmdx.trials.engines.warp import worlds as warp_worlds
from gmdx.trials.observations import ChunkResult
from gmdx.trials.outcome import Outcome
from gmdx.trials.placement import place
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials
from tests.support import box_object, resting_scene

ON_CPU = pytest.mark.skipif(
    cuda_devices() > 0, reason="on a GPU the order of contacts, and so the last bits, may differ"
)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    """Three boxes, as objects of their own."""
    sizes = ((0.03, 0.04, 0.05), (0.02, 0.05, 0.03), (0.04, 0.04, 0.04))
    return [resting_scene(box_object(size, object_id=f"box{k}")) for k, size in enumerate(sizes)]


@pytest.fixture(scope="module")
def grasps() -> list[PlanarGrasp]:
    rng = np.random.default_rng(3)

    def some(n: int) -> PlanarGrasp:
        center = np.column_stack([rng.uniform(-0.015, 0.015, (n, 2)), rng.uniform(0.012, 0.04, n)])
        return PlanarGrasp(
            np.arange(n) * 7, center, rng.uniform(0, np.pi, n), rng.uniform(0.06, 0.085, n)
        )

    return [some(n) for n in (4, 3, 5)]


@pytest.fixture(scope="module")
def mixed(scenes: list[Scene], grasps: list[PlanarGrasp]) -> list[TrialResults]:
    return run_trials(scenes, grasps, "warp", trials=2)


def _same(a: TrialResults, b: TrialResults) -> None:
    for name in ("outcome", "collision", "object_position", "object_quaternion", "opening",
                 "push_force", "push_force_is_lower_bound"):  # fmt: skip
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(a.contacts.points, b.contacts.points)


def test_the_sample_sees_more_than_one_outcome(mixed: list[TrialResults]) -> None:
    outcomes = np.concatenate([found.outcome.ravel() for found in mixed])
    assert len(np.unique(outcomes)) >= 3
    assert (outcomes == Outcome.SUCCESS).any()


@ON_CPU
def test_mixed_and_separate_runs_agree_trial_by_trial(
    scenes: list[Scene], grasps: list[PlanarGrasp], mixed: list[TrialResults]
) -> None:
    for scene, some, found in zip(scenes, grasps, mixed, strict=True):
        _same(found, run_trials(scene, some, "warp", trials=2))


@ON_CPU
def test_batches_change_no_trial(
    scenes: list[Scene], grasps: list[PlanarGrasp], mixed: list[TrialResults]
) -> None:
    found = run_trials(scenes, grasps, "warp", trials=2, parallel_trials=5)
    for one, other in zip(found, mixed, strict=True):
        _same(one, other)


def test_c_mujoco_runs_several_scenes_as_it_runs_each(
    scenes: list[Scene], grasps: list[PlanarGrasp]
) -> None:
    found = run_trials(scenes, grasps, trials=2)
    for scene, some, one in zip(scenes, grasps, found, strict=True):
        _same(one, run_trials(scene, some, trials=2))


class _Small:
    """Warp's implementation on a device that has room for so many trials and no more."""

    def __init__(self, room: int, *, at_launch: bool) -> None:
        self.room, self.at_launch = room, at_launch
        self.opened: list[int] = []
        self.bucket, self.version = warp_worlds.bucket, warp_worlds.version

    def suggested_capacity(self, models: Sequence[GraspModel]) -> int | None:
        return 16

    def open_worlds(
        self, models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
    ) -> Worlds:
        self.opened.append(capacity)
        if capacity > self.room and not self.at_launch:
            raise DeviceMemoryError(f"no room for {capacity} trials")
        worlds = warp_worlds.open_worlds(models, capacity=capacity, physics=physics)
        return _SmallWorlds(worlds, full=capacity > self.room)


class _SmallWorlds:
    def __init__(self, worlds: Worlds, *, full: bool) -> None:
        self.worlds, self.full, self.lanes = worlds, full, 1

    def launch(self, *arrays: np.ndarray) -> Callable[[], ChunkResult]:
        if self.full:
            raise DeviceMemoryError("no room for these trials")
        return self.worlds.launch(*arrays)


@ON_CPU
@pytest.mark.parametrize("at_launch", [False, True])
def test_a_device_that_is_full_gets_smaller_batches(
    scenes: list[Scene],
    grasps: list[PlanarGrasp],
    mixed: list[TrialResults],
    at_launch: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    small = _Small(5, at_launch=at_launch)
    engine = ParallelEngine("warp", small)
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        found = run_trials(scenes[:1], grasps[:1], engine, trials=2)
    assert small.opened == [16, 8, 4]
    assert len([text for text in caplog.messages if "side by side" in text]) == 2
    _same(found[0], mixed[0])


def test_a_device_without_any_room_is_an_error(
    scenes: list[Scene], grasps: list[PlanarGrasp]
) -> None:
    engine = ParallelEngine("warp", _Small(0, at_launch=True))
    with pytest.raises(DeviceMemoryError, match="no room"):
        run_trials(scenes[:1], grasps[:1], engine, trials=1)


def test_survivors_alone_are_simulated(scenes: list[Scene], grasps: list[PlanarGrasp]) -> None:
    """Every launch holds live trials only: as many steps as the results report, not one more."""
    ran = 0

    class Counted(_Small):
        def open_worlds(
            self, models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
        ) -> Worlds:
            worlds = super().open_worlds(models, capacity=capacity, physics=physics)
            launch = worlds.launch

            def noted(*arrays: np.ndarray) -> Callable[[], ChunkResult]:
                nonlocal ran
                ran += int(arrays[-1].sum())
                assert len(arrays[0]) <= capacity
                return launch(*arrays)

            worlds.launch = noted  # type: ignore[method-assign]
            return worlds

    engine = ParallelEngine("warp", Counted(16, at_launch=True))
    (found,) = run_trials(scenes[:1], grasps[:1], engine, trials=2)
    assert ran == found.steps
    config = TrialConfig()
    batch = place(scenes[0], grasps[0], trials=2, gripper=load_gripper(), config=config)
    schedule = batch.schedule(config)
    assert found.steps < 8 * sum(len(phase) for phase in vars(schedule).values())


def test_no_scenes_and_no_grasps_are_no_results(
    scenes: list[Scene], grasps: list[PlanarGrasp]
) -> None:
    assert run_trials([], [], "warp") == []
    (found,) = run_trials(scenes[:1], [grasps[0][:0]], "warp")
    assert len(found) == 0


def test_names_of_engines() -> None:
    for name in ("mujoco", "warp", "bullet"):
        assert choose(name) == name
    for wrong in ("mjy", "mjx", "mjx-warp", ""):
        with pytest.raises(ConfigError, match=rf"unknown engine '{wrong}'.*mujoco, warp, bullet"):
            choose(wrong)


def test_auto_is_warp_where_there_is_a_device_for_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("gmdx.trials.engines.registry.cuda_devices", lambda: 0)
    assert choose("auto") == "mujoco"
    with caplog.at_level(logging.INFO, logger="gmdx"):
        open_engine("auto")
    assert "engine auto: mujoco runs the trials" in caplog.text
    monkeypatch.setattr("gmdx.trials.engines.registry.cuda_devices", lambda: 1)
    assert choose("auto") == "warp"


def test_a_push_that_is_borne_to_its_end_gives_the_same_lower_bound() -> None:
    """The ramp is no whole number of chunks long."""
    scene = resting_scene(box_object((0.03, 0.04, 0.05), friction=2.6))
    grasp = PlanarGrasp(np.zeros(1, int), np.array([[0, 0, 0.025]]), np.zeros(1), np.full(1, 0.05))
    reference = run_trials(scene, grasp, trials=1)
    found = run_trials(scene, grasp, "warp", trials=1)
    assert reference.push_force_is_lower_bound[0]
    assert found.push_force_is_lower_bound[0]
    assert found.push_force[0] == reference.push_force[0] == pytest.approx(60.0)


def test_a_cancelled_run_ends_at_its_next_launch(
    scenes: list[Scene], grasps: list[PlanarGrasp]
) -> None:
    launched = 0

    class Watched(_Small):
        def open_worlds(
            self, models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
        ) -> Worlds:
            worlds = super().open_worlds(models, capacity=capacity, physics=physics)
            launch = worlds.launch

            def noted(*arrays: np.ndarray) -> Callable[[], ChunkResult]:
                nonlocal launched
                launched += 1
                engine.cancel()
                return launch(*arrays)

            worlds.launch = noted  # type: ignore[method-assign]
            return worlds

    engine = ParallelEngine("warp", Watched(16, at_launch=True))
    with pytest.raises(Cancelled):
        run_trials(scenes[:1], grasps[:1], engine, trials=1)
    assert launched == 1


def test_a_smaller_batch_gets_the_memory_of_the_larger_one(
    scenes: list[Scene], grasps: list[PlanarGrasp]
) -> None:
    """Nothing holds what did not fit: it is gone before it is tried again."""
    held: list[weakref.ref[Worlds]] = []

    class Watched(_Small):
        def open_worlds(
            self, models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
        ) -> Worlds:
            assert not any(worlds() is not None for worlds in held)
            worlds = super().open_worlds(models, capacity=capacity, physics=physics)
            held.extend(weakref.ref(part) for part in worlds.worlds.parts)  # type: ignore[attr-defined]
            return worlds

    engine = ParallelEngine("warp", Watched(5, at_launch=True))
    gc.collect()
    gc.disable()
    try:
        run_trials(scenes[:1], grasps[:1], engine, trials=2)
    finally:
        gc.enable()
    assert len(held) == 3
    assert not any(worlds() is not None for worlds in held)


def test_scenes_and_grasps_come_in_pairs(scenes: list[Scene], grasps: list[PlanarGrasp]) -> None:
    for wrong in ((scenes, grasps[:2]), (scenes, grasps[0]), (scenes[0], grasps)):
        with pytest.raises(UsageError, match="one record of grasps for each scene"):
            run_trials(*wrong)


def test_pyramidal_cones_are_refused_with_the_reason() -> None:
    with pytest.raises(ConfigError, match=r"pyramidal friction cones are refused.*0\.81"):
        PhysicsConfig(cone="pyramidal")
    with pytest.raises(ConfigError, match="unknown cone 'round'"):
        PhysicsConfig(cone="round")
