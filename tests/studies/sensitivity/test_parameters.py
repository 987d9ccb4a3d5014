"""Parameters change the physics that they claim to, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from gmdx.errors import UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.objects.decompose.decomposition import DecomposeConfig
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.settle import lowest_points
from gmdx.studies.sensitivity.parameters import (
    HULL_BOUNDS,
    JITTER,
    PARAMETERS,
    Setup,
    decomposition_for,
    parameters_named,
)
from gmdx.studies.sensitivity.runs import changed, measure
from gmdx.trials.protocol import TrialConfig
from tests.support import box_object, resting_scene

GRAVITY = 9.81
EXTENTS = (0.03, 0.04, 0.05)
names = pytest.mark.parametrize("name", PARAMETERS)


def box_setup(*, mass: float = 0.1, trials: int = 1, grasps: int = 1) -> Setup:
    """Grasps side by side through the middle of a box, closing along x."""
    obj = box_object(EXTENTS, mass=mass)
    side = np.linspace(-0.004, 0.004, grasps) if grasps > 1 else np.zeros(1)
    centers = np.stack([np.zeros(grasps), side, np.full(grasps, 0.025)], axis=1)
    batch = PlanarGrasp(np.arange(grasps), centers, np.zeros(grasps), np.full(grasps, 0.05))
    inside = tuple(0.98 * hull for hull in obj.hulls)
    outside = tuple(1.02 * hull for hull in obj.hulls)
    return Setup(
        resting_scene(obj),
        batch,
        load_gripper(),
        trials,
        TrialConfig(),
        dict(zip(HULL_BOUNDS, (inside, obj.hulls, outside), strict=True)),
    )


def force(setup: Setup, **values: float) -> float:
    found = measure(changed(setup, values))
    assert found["held"] == found["grasps"]
    assert found["lower_bounds"] == 0
    return float(found["force"])


@names
def test_a_change_is_read_back_and_leaves_every_other_parameter(name: str) -> None:
    setup, parameter = box_setup(), PARAMETERS[name]
    for value in parameter.values(np.array([0.0, 0.4, 1.0])):
        now = parameter.change(setup, float(value))
        for other in PARAMETERS.values():
            expected = other.default(setup)
            if other is parameter and name != "grasp_height":
                expected = float(value)
            assert other.default(now) == pytest.approx(expected, rel=1e-12), other.name
    if name == "grasp_height":
        shift = parameter.change(setup, 0.002).grasps.center - setup.grasps.center
        np.testing.assert_allclose(shift, [[0.0, 0.0, 0.002]], atol=1e-15)


@names
def test_ranges_hold_the_default_and_have_a_reason(name: str) -> None:
    parameter = PARAMETERS[name]
    default = parameter.default(box_setup())
    assert parameter.low <= default <= parameter.high
    assert len(parameter.reason) > 30
    values = parameter.values(np.linspace(0, 1, 12))
    assert np.all(np.diff(values) >= 0)
    assert (values[0], values[-1]) == pytest.approx((parameter.low, parameter.high))
    if parameter.levels:
        assert set(values) == set(parameter.levels)


@pytest.mark.parametrize("name", [name for name in PARAMETERS if name != "seed"])
def test_defaults_change_nothing(name: str) -> None:
    """Of every parameter but the seed, which moves the grasps whatever it is."""
    setup, parameter = box_setup(trials=2), PARAMETERS[name]
    plain = measure(setup)
    same = measure(parameter.change(setup, parameter.default(setup)))
    assert same == pytest.approx(plain, nan_ok=True, rel=1e-9)


def test_push_out_force_follows_friction_closing_force_and_weight() -> None:
    setup = box_setup()
    pad = setup.gripper.force
    for friction in (0.4, 0.8):
        expected = 2 * friction * pad - 0.1 * GRAVITY
        assert force(setup, friction=friction) == pytest.approx(expected, rel=0.05)
    for closing_force in (10.0, 40.0):
        expected = 2 * 0.8 * closing_force - 0.1 * GRAVITY
        assert force(setup, closing_force=closing_force) == pytest.approx(expected, rel=0.05)
    light, heavy = force(setup, mass=0.03), force(setup, mass=0.5)
    assert light - heavy == pytest.approx(0.47 * GRAVITY, rel=0.15)


def test_mass_takes_the_inertia_along() -> None:
    setup = box_setup()
    obj = changed(setup, {"mass": 0.4}).scene.object
    np.testing.assert_allclose(obj.inertia, 4 * setup.scene.object.inertia)
    assert obj.mass == 0.4


def test_success_and_force_rise_with_friction_and_closing_force() -> None:
    heavy = box_setup(mass=2.0, trials=3, grasps=3)  # held only where 2 mu N is above its weight
    for name, values in (
        ("friction", (0.3, 0.5, 0.7, 1.0)),
        ("closing_force", (8.0, 13.0, 20.0, 40.0)),
    ):
        found = [measure(changed(heavy, {name: value})) for value in values]
        success = [one["success"] for one in found]
        forces = [one["force"] for one in found if one["held"]]
        assert np.all(np.diff(success) >= 0), name
        assert success[0] == 0
        assert success[-1] == 1
        assert np.all(np.diff(forces) > 0), name
        assert np.isnan(found[0]["force"])  # nothing is held: no force, not zero


def test_other_hulls_rest_where_the_first_ones_did() -> None:
    setup = box_setup()
    for bound in HULL_BOUNDS:
        now = changed(setup, {"hulls": bound})
        assert lowest_points(now.scene).hulls == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_array_equal(now.scene.object.vertices, setup.scene.object.vertices)
        ratio = now.scene.object.hulls[0] / setup.scene.object.hulls[0]
        expected = {HULL_BOUNDS[0]: 0.98, HULL_BOUNDS[1]: 1.0, HULL_BOUNDS[2]: 1.02}[bound]
        np.testing.assert_allclose(ratio, expected)
    back = changed(changed(setup, {"hulls": HULL_BOUNDS[0]}), {"hulls": HULL_BOUNDS[1]})
    np.testing.assert_allclose(back.scene.position, setup.scene.position, atol=1e-15)


def test_decomposition_at_the_default_bound_is_the_default() -> None:
    default = DecomposeConfig()
    assert decomposition_for(HULL_BOUNDS[1]) == default
    coarse = decomposition_for(HULL_BOUNDS[2])
    assert coarse.fidelity.distance == HULL_BOUNDS[2]
    assert coarse.fidelity.volume == pytest.approx(2 * default.fidelity.volume)


def test_seed_redraws_noise_and_moves_grasps_by_next_to_nothing() -> None:
    setup = box_setup(trials=4, grasps=3)
    one, same, other = (changed(setup, {"seed": s}) for s in (5.0, 5.0, 6.0))
    np.testing.assert_array_equal(one.grasps.center, same.grasps.center)
    assert not np.array_equal(one.grasps.center, other.grasps.center)
    assert np.abs(one.grasps.center - setup.grasps.center).max() <= 2 * JITTER
    assert one.scene.seed == 5
    # A box held in its middle does not care.
    assert force(one) == pytest.approx(force(other), rel=0.02)


def test_timestep_keeps_the_looks_at_a_trial_in_seconds() -> None:
    setup = box_setup()
    span = setup.config.chunk(setup.scene.physics.timestep) * setup.scene.physics.timestep
    for timestep in (0.001, 0.002, 0.005):
        now = changed(setup, {"timestep": timestep})
        assert now.scene.physics.timestep == timestep
        assert now.config.chunk(timestep) * timestep == pytest.approx(span, abs=timestep)


def test_names_are_put_in_order_and_unknown_ones_refused() -> None:
    found = [parameter.name for parameter in parameters_named(["mass", "friction"])]
    assert found == ["friction", "mass", "seed"]
    with pytest.raises(UsageError, match=r"'frictoin' \(did you mean 'friction'\?\): there are"):
        parameters_named(["mass", "frictoin"])
    for wrong in (["mass", "mass"], ["seed"], []):
        with pytest.raises(UsageError, match="one besides 'seed'"):
            parameters_named(wrong)


def test_all_changes_together_still_run() -> None:
    setup = box_setup(trials=2)
    rng = np.random.default_rng(0)
    values = {n: float(p.values(rng.random(1))[0]) for n, p in PARAMETERS.items()}
    found = measure(changed(setup, values))
    assert found["diverged"] == 0
    assert 0 <= found["success"] <= 1
    assert changed(setup, dict.fromkeys(PARAMETERS, np.nan)) == replace(setup)
