"""The rules' view of steps, against loops over single contacts and against JAX."""

import numpy as np
import pytest

from gmdx.scenes.layout import PAD_SLOTS, SLOT_SIZE, ContactSensors
from gmdx.trials import observations
from gmdx.trials.observations import ChunkResult, ObservedSteps

_PAD = PAD_SLOTS * SLOT_SIZE
LAYOUT = ContactSensors(
    pads=(slice(0, _PAD), slice(_PAD, 2 * _PAD)),
    hand=2 * _PAD,
    hand_table=2 * _PAD + 1,
    object_table=2 * _PAD + 2,
)


def _steps(n: int = 40, s: int = 7) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states and sensors in which every rule is sometimes true and sometimes not."""
    rng = np.random.default_rng(1)
    qpos, qvel = rng.normal(size=(n, s, 10)), rng.normal(size=(n, s, 9))
    qvel[3, 2, 4] = np.nan
    qpos[5, 1, 0] = np.inf
    pads = np.zeros((n, s, 2, PAD_SLOTS, SLOT_SIZE))
    contacts = rng.integers(0, 3, size=(n, s, 2))
    for index in np.ndindex(n, s, 2):
        for k in range(contacts[index]):
            pads[index][k, 0] = contacts[index]
            pads[index][k, 1] = rng.choice([0.0, 3.0])
            normal = np.array([1.0, 0.0, 0.0]) if rng.random() < 0.8 else rng.normal(size=3)
            pads[index][k, 8:] = normal / np.linalg.norm(normal)
    others = rng.random((n, s)) < 0.1
    hand = contacts.sum(axis=2) + others
    table = (rng.random((n, s)) < 0.1).astype(float)
    rest = np.stack([hand, table, np.zeros((n, s))], axis=-1)
    return qpos, qvel, np.concatenate([pads.reshape(n, s, -1), rest], axis=-1)


def test_observed_steps_are_what_single_contacts_say() -> None:
    qpos, qvel, sensors = _steps()
    seen_steps = observations.observe(qpos, qvel, sensors, LAYOUT)
    seen = set()
    for i, k in np.ndindex(*qpos.shape[:2]):
        slots = sensors[i, k, : 2 * _PAD].reshape(2 * PAD_SLOTS, SLOT_SIZE)
        found = [slot for slot in slots if slot[0] > 0]
        beside = any(abs(slot[8]) < np.cos(np.pi / 4) for slot in found)
        hand, table = sensors[i, k, LAYOUT.hand], sensors[i, k, LAYOUT.hand_table]
        assert seen_steps.collides[i, k] == (beside or table > 0 or hand > len(found))
        assert seen_steps.touches[i, k] == (hand > 0)
        assert seen_steps.presses[i, k] == any(slot[1] > 0 for slot in found)
        seen |= {(seen_steps.collides[i, k], seen_steps.touches[i, k], seen_steps.presses[i, k])}
    assert len(seen) >= 5
    assert np.isinf(seen_steps.speed[3, 2])
    assert np.isinf(seen_steps.speed[5, 1])
    others = np.delete(np.abs(qvel[0, 0]), [3, 4, 5])
    assert seen_steps.speed[0, 0] == others.max()
    np.testing.assert_array_equal(seen_steps.offset[0, 0], qpos[0, 0, :3] - [0, 0, qpos[0, 0, 7]])


def test_jax_sees_the_same() -> None:
    jax = pytest.importorskip("jax", reason="the extra gmdx[jax] is not installed")
    qpos, qvel, sensors = _steps()
    expected = observations.observe(qpos, qvel, sensors, LAYOUT)

    def traced(*arrays: object) -> dict[str, object]:
        return observations.observed_fields(*arrays, LAYOUT)

    with jax.enable_x64(True):
        found = jax.jit(traced)(qpos, qvel, sensors)
    for name, value in vars(expected).items():
        np.testing.assert_array_equal(np.asarray(found[name]), value, err_msg=name)


def test_letting_go_looks_at_the_last_five_steps_that_a_trial_ran() -> None:
    rng = np.random.default_rng(2)
    presses = rng.random((300, 12)) < 0.15
    count = rng.integers(1, 13, 300)
    seen_steps = _digest(presses)
    expected = [not row[max(0, c - 5) : c].any() for row, c in zip(presses, count, strict=True)]
    np.testing.assert_array_equal(observations.lets_go(seen_steps, count), expected)


def test_stretches_are_joined_in_order() -> None:
    rng = np.random.default_rng(3)

    def part(n: int) -> ChunkResult:
        numbers = rng.normal(size=(n, 20))
        flags = numbers[:, 0] > 0
        return ChunkResult(numbers, numbers[:, :10], numbers, flags, ~flags, _digest(numbers > 0))

    parts = [part(3), part(1), part(4)]
    whole = observations.joined(parts)
    np.testing.assert_array_equal(whole.state[3], parts[1].state[0])
    np.testing.assert_array_equal(whole.steps.presses[4:], parts[2].steps.presses)
    np.testing.assert_array_equal(whole.overflowed, ~whole.failed)


def _digest(presses: np.ndarray) -> ObservedSteps:
    zeros = np.zeros(presses.shape)
    vectors = np.zeros((*presses.shape, 3))
    return ObservedSteps(presses, presses, presses, zeros, vectors, vectors, zeros)
