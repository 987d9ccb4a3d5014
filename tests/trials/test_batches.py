"""A trial's numbers are its own: not its batch's, its threads', or its world's orientation."""

from dataclasses import fields, replace

import numpy as np
import pytest

from gmdx.geometry import quaternion_multiply, yaw_quaternion
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.perturb import perturb
from gmdx.trials.protocol import NoiseConfig
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials
from tests.support import box_object, resting_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return resting_scene(box_object((0.03, 0.04, 0.05)))


@pytest.fixture(scope="module")
def grasps() -> PlanarGrasp:
    rng = np.random.default_rng(3)
    center = np.column_stack([rng.uniform(-0.02, 0.02, (24, 2)), rng.uniform(0.012, 0.06, 24)])
    return PlanarGrasp(
        np.arange(24) * 7, center, rng.uniform(0, np.pi, 24), rng.uniform(0.055, 0.085, 24)
    )


@pytest.fixture(scope="module")
def trials(scene: Scene, grasps: PlanarGrasp) -> TrialResults:
    return run_trials(scene, grasps)


def _equal(a: TrialResults, b: TrialResults) -> bool:
    def arrays(results: TrialResults) -> list[np.ndarray]:
        found = []
        for field in fields(results):
            value = getattr(results, field.name)
            if isinstance(value, PadContacts):
                found += [value.points, value.normals, value.valid]
            elif isinstance(value, np.ndarray):
                found.append(value)
        return found

    return all(x.tobytes() == y.tobytes() for x, y in zip(arrays(a), arrays(b), strict=True))


def test_the_sample_sees_more_than_one_outcome(trials: TrialResults) -> None:
    assert len(np.unique(trials.outcome)) >= 3
    assert (trials.outcome == Outcome.SUCCESS).any()


@pytest.mark.parametrize("threads", [1, 2])
def test_batches_and_threads_change_no_byte(
    scene: Scene, grasps: PlanarGrasp, trials: TrialResults, threads: int
) -> None:
    assert _equal(trials, run_trials(scene, grasps, threads=threads))
    for part in (slice(0, 5), slice(5, 6), slice(6, 24)):
        alone = run_trials(scene, grasps[part], threads=threads)
        assert alone.outcome.tobytes() == trials.outcome[part].tobytes()
        assert alone.object_position.tobytes() == trials.object_position[part].tobytes()
        assert alone.push_force.tobytes() == trials.push_force[part].tobytes()
        assert alone.contacts.points.tobytes() == trials.contacts.points[part].tobytes()


def test_a_turned_and_shifted_world_changes_nothing(
    scene: Scene, grasps: PlanarGrasp, trials: TrialResults
) -> None:
    angle, shift = 0.83, np.array([0.4, -0.7, 0.0])
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = replace(
        scene,
        position=R @ scene.position + shift,
        quaternion=quaternion_multiply(yaw_quaternion(np.array(angle)), scene.quaternion),
    )
    moved = PlanarGrasp(
        grasps.grasp_id, grasps.center @ R.T + shift, grasps.angle + angle, grasps.width
    )
    other = run_trials(turned, moved)
    # Roundoff of the turn may tip a trial that balances on an edge, hence not every outcome.
    same = np.all(other.outcome == trials.outcome, axis=1)
    assert same.mean() >= 0.95
    np.testing.assert_allclose(
        other.object_position[same], trials.object_position[same] @ R.T + shift, atol=1e-5
    )
    np.testing.assert_allclose(other.opening[same], trials.opening[same], atol=1e-5)


def test_noise_is_keyed_by_grasp_and_bounded(scene: Scene, grasps: PlanarGrasp) -> None:
    noise = NoiseConfig()
    center, angle = perturb(scene, grasps, trials=5, noise=noise)
    np.testing.assert_array_equal(center[:, 0], grasps.center)
    np.testing.assert_array_equal(angle[:, 0], grasps.angle)
    shift, turn = center - grasps.center[:, None], angle - grasps.angle[:, None]
    assert np.abs(turn).max() <= 2 * noise.angle + 1e-12
    assert np.linalg.norm(shift[..., :2], axis=-1).max() <= 2 * np.sqrt(2) * noise.position + 1e-12
    assert len(np.unique(turn[:, 1:])) == 24 * 4
    # A standard normal cut at two deviations has standard deviation 0.88 (clipped: 0.96).
    assert turn[:, 1:].std() == pytest.approx(0.96 * noise.angle, rel=0.15)

    alone, _ = perturb(scene, grasps[7:8], trials=3, noise=noise)
    np.testing.assert_array_equal(alone[0], center[7, :3])
    other, _ = perturb(replace(scene, seed=1), grasps, trials=5, noise=noise)
    assert not np.array_equal(other[:, 1:], center[:, 1:])
