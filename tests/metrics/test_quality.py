from dataclasses import replace

import numpy as np
import pytest

from gmdx.errors import ConfigError
from gmdx.grasps.grasp import PadContacts
from gmdx.metrics import quality
from gmdx.metrics.epsilon.certified import epsilon
from gmdx.metrics.epsilon.many import KERNEL, EpsilonBatch
from gmdx.metrics.quality import Evidence, PadSet, QualityConfig, Tally, audit_sample, pad_qualities
from tests.metrics.epsilon_grasps import pads, pair
from tests.support import box_object, resting_scene

BOX = box_object((0.04, 0.06, 0.08))
SCENE = resting_scene(BOX)
CONFIG = QualityConfig().resolved()


def contacts_of(grasps: list[dict[str, np.ndarray]]) -> PadContacts:
    """Grasps whose first half of contacts belongs to pad 0."""
    slots = max(len(g["points"]) for g in grasps) // 2
    points = np.full((len(grasps), 2, slots, 3), np.nan)
    normals = points.copy()
    for i, g in enumerate(grasps):
        half = len(g["points"]) // 2
        points[i, :, :half] = g["points"].reshape(2, half, 3)
        normals[i, :, :half] = g["normals"].reshape(2, half, 3)
    return PadContacts(points, normals, np.isfinite(points).all(axis=3))


def mixture(n: int) -> PadContacts:
    """Pairs, patches, and grasps without contact on one pad."""
    rng = np.random.default_rng(3)
    made = contacts_of([pair(rng) if i % 3 else pads(rng, 3, curved=True) for i in range(n)])
    valid = made.valid.copy()
    valid[::7, 0] = False
    keep = valid[..., None]
    return PadContacts(
        np.where(keep, made.points, np.nan), np.where(keep, made.normals, np.nan), valid
    )


def measured(contacts: PadContacts, audited: np.ndarray, **changes: float) -> quality.Qualities:
    config = replace(CONFIG, **changes)
    sets = {"quality": PadSet(contacts, rtol=1e-4)}
    return pad_qualities(sets, SCENE, audited=audited, config=config).by_name["quality"]


def test_the_tally_counts_what_the_certified_routine_says() -> None:
    contacts = mixture(30)
    found = measured(contacts, np.ones(30, bool))
    tally = found.tally
    expected = []
    for i in np.flatnonzero(contacts.both):
        valid = contacts.valid[i]
        one = epsilon(
            contacts.points[i][valid],
            contacts.normals[i][valid],
            friction=BOX.friction,
            torsion=2 / 3 * BOX.friction * 0.005,
            torque_scale=BOX.radius,
            origin=np.zeros(3),
        )
        expected.append(max(one.upper, 0.0))
        assert found.lower[i] <= max(one.upper, 0.0) * (1 + 1e-12)
        assert max(one.lower, 0.0) <= found.upper[i] * (1 + 1e-12)
    both = contacts.both
    np.testing.assert_allclose(found.upper[both], expected, rtol=2e-4)
    assert np.isnan(found.upper[~both]).all()
    assert tally.values == both.sum() == sum(tally.methods.values())
    assert tally.closed == np.count_nonzero(expected)
    assert tally.certified == tally.values
    assert 0 < tally.worst_gap <= 1e-4
    pairs = contacts.valid[contacts.both].sum(axis=(1, 2)) == 2
    assert tally.audited == pairs.sum() > tally.methods[KERNEL] > 0  # those without closure too
    assert tally.worst_audit < 1e-6


def test_a_wrong_kernel_would_be_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The audit compares with another routine: a value that is off shows as off."""
    contacts = mixture(30)
    real = quality.epsilon_batch

    def off(*arguments: object, **options: object) -> EpsilonBatch:
        found = real(*arguments, **options)  # type: ignore[arg-type]
        return replace(found, upper=found.upper * 1.01)

    monkeypatch.setattr(quality, "epsilon_batch", off)
    tally = measured(contacts, np.ones(30, bool)).tally
    assert tally.worst_audit == pytest.approx(0.01, rel=1e-3)
    assert tally.certified < tally.values
    assert tally.worst_gap == pytest.approx(0.01, rel=0.02)


def test_tallies_of_parts_make_that_of_the_whole() -> None:
    contacts, drawn = mixture(40), np.random.default_rng(0).random(40) < 0.5
    whole = measured(contacts, drawn)
    parts = [slice(0, 1), slice(1, 17), slice(17, 40)]
    each = [measured(contacts[part], drawn[part]) for part in parts]
    for name in ("lower", "upper"):
        joined = np.concatenate([getattr(part, name) for part in each])
        assert joined.tobytes() == getattr(whole, name).tobytes()
    tally = sum((part.tally for part in each), Tally())
    assert tally == whole.tally
    evidence = [Evidence({"pair_epsilon": "numpy"}, {"g_quality": part.tally}) for part in each]
    assert sum(evidence, Evidence()).qualities == {"g_quality": whole.tally}
    assert sum(evidence, Evidence()).kernels == {"pair_epsilon": "numpy"}


def test_sets_that_are_computed_together_do_not_mix() -> None:
    contacts, drawn = mixture(21), np.arange(21) % 2 == 0
    few = contacts_of([pair(np.random.default_rng(9)) for _ in range(21)])
    sets = {"patches": PadSet(contacts, rtol=1e-2), "pairs": PadSet(few, rtol=1e-4)}
    together = pad_qualities(sets, SCENE, audited=drawn, config=CONFIG).by_name
    assert list(together) == list(sets)
    for name, found in together.items():
        alone = pad_qualities({name: sets[name]}, SCENE, audited=drawn, config=CONFIG).by_name[name]
        assert found.lower.tobytes() == alone.lower.tobytes()
        assert found.upper.tobytes() == alone.upper.tobytes()
        assert found.tally == alone.tally
        assert found.seconds > 0
    assert together["patches"].tally.worst_gap > 1e-4 >= together["pairs"].tally.worst_gap


def test_the_audit_draws_by_seed_and_grasp_alone() -> None:
    scene = resting_scene(BOX)
    ids = np.arange(2000)
    drawn = audit_sample(scene, ids, share=0.1)
    np.testing.assert_allclose(np.add.reduceat(drawn, ids[::20]), 2, atol=1)
    np.testing.assert_array_equal(
        audit_sample(scene, ids[::-1][:100], share=0.1), drawn[::-1][:100]
    )
    others = [audit_sample(replace(scene, scene_id=k), ids[:20], share=0.1) for k in range(9)]
    assert len({other.tobytes() for other in others}) > 3
    assert audit_sample(scene, ids, share=1.0).all()
    assert not audit_sample(scene, ids, share=0.0).any()


def test_bounds_of_grazing_pairs_do_not_cross() -> None:
    """The contact line all but leaves a friction cone: qualities near 0, and below."""
    grazing = []
    for k, excess in enumerate(np.geomspace(1e-12, 1e-4, 60)):
        angle = np.arctan(0.8) - excess * (1 if k % 4 else -1)
        normals = np.array([[np.cos(angle), np.sin(angle), 0.0], [-1.0, 0, 0]])
        grazing.append({"points": np.array([[-0.02, 0, 0], [0.02, 0, 0]]), "normals": normals})
    found = measured(contacts_of(grazing), np.ones(60, bool))
    assert (found.lower >= 0).all()
    assert (found.lower <= found.upper).all()
    assert found.tally.closed == (found.lower > 0).sum() > 0
    assert found.tally.worst_audit < 1e-6


def test_nothing_to_measure_is_nothing_measured() -> None:
    nothing = PadContacts(
        np.full((3, 2, 1, 3), np.nan), np.full((3, 2, 1, 3), np.nan), np.zeros((3, 2, 1), bool)
    )
    found = measured(nothing, np.ones(3, bool))
    assert np.isnan(found.upper).all()
    assert found.tally == Tally()


def test_configurations_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"pair_epsilon.*'cuda'.*auto, numpy, jax"):
        QualityConfig(implementation="cuda")
    for name, value in (("rtol_pair", 1e-9), ("rtol_patch", np.inf)):
        with pytest.raises(ConfigError, match=name):
            QualityConfig(**{name: value})
    for share in (-0.1, 1.1, float("nan")):
        with pytest.raises(ConfigError, match="audit"):
            QualityConfig(audit=share)
