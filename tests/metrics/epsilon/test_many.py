import numpy as np
import pytest

from gmdx.errors import MetricError
from gmdx.metrics.epsilon.certified import epsilon
from gmdx.metrics.epsilon.many import KERNEL, epsilon_batch
from tests.metrics.epsilon_grasps import grasp, opposed, pads, pair


def batch_of(grasps, slots):
    points = np.full((len(grasps), slots, 3), np.nan)
    normals, valid = points.copy(), np.zeros((len(grasps), slots), bool)
    for i, g in enumerate(grasps):
        where = np.random.default_rng(i).permutation(slots)[: len(g["points"])]
        points[i, where], normals[i, where] = g["points"], g["normals"]
        valid[i, where] = True
    return points, normals, valid


def test_a_batch_agrees_with_single_grasps():
    rng = np.random.default_rng(14)
    grasps = [pads(rng, 4, curved=True), pair(rng, tilt=0.2), pair(rng, tilt=3.0)]
    grasps += [grasp(np.zeros((0, 3)), np.zeros((0, 3)))]
    parameters = {"friction": 0.8, "torsion": 0.003, "torque_scale": 0.05, "origin": np.zeros(3)}
    points, normals, valid = batch_of(grasps, 9)
    unsigned = epsilon_batch(points, normals, valid, **parameters, rtol=1e-3)
    signed = epsilon_batch(points, normals, valid, **parameters, rtol=1e-3, signed=True)
    single = [epsilon(**g, rtol=1e-3) for g in grasps[:3]]
    assert not single[2].closure
    for i, e in enumerate(single):
        assert signed.lower[i] <= e.upper
        assert e.lower <= signed.upper[i]
        assert signed.closure[i] == unsigned.closure[i] == e.closure
        assert signed.method[i] == (KERNEL if i else e.method)  # the second and third are pairs
    assert (unsigned.lower[valid.any(axis=1)] >= 0).all()
    assert (unsigned.lower[2], unsigned.upper[2], unsigned.method[2]) == (0.0, 0.0, "no closure")
    assert np.isnan(unsigned.direction[2]).all()
    assert np.isnan([signed.lower[3], signed.upper[3]]).all()
    assert signed.method[3] == "no contact"
    assert not signed.closure[3]


def test_bad_batches_are_refused():
    points, normals, valid = batch_of([opposed(0.03)], 2)
    parameters = {"torsion": 0.003, "torque_scale": 0.05, "origin": np.zeros(3)}
    with pytest.raises(MetricError, match="friction"):
        epsilon_batch(points, normals, valid, friction=-0.1, **parameters)
    normals[0] *= 2
    with pytest.raises(MetricError, match="normals"):
        epsilon_batch(points, normals, valid, friction=0.8, **parameters)


def test_arguments_of_a_batch_are_named():
    points, normals, valid = batch_of([opposed(0.03), opposed(0.02)], 2)
    parameters = {"friction": 0.8, "torsion": 0.003, "origin": np.zeros(3)}
    for name, value in (
        ("implementation", "cuda"),
        ("rtol", np.array([1e-3, 0.0])),
        ("rtol", float("nan")),
        ("rtol", -1.0),
        ("points", 1e-300),  # of a torque scale beyond all proportion
    ):
        options = {"torque_scale": value} if name == "points" else {name: value}
        with pytest.raises(MetricError, match=name):
            epsilon_batch(points, normals, valid, **{"torque_scale": 0.05, **parameters, **options})
    with pytest.raises(MetricError, match="rtol"):
        epsilon_batch(points, normals, valid, torque_scale=0.05, **parameters, rtol_bulk=-1.0)


@pytest.mark.parametrize(("n", "k"), [(0, 0), (0, 3), (2, 0), (2, 1)])
def test_batches_without_pairs(n, k):
    empty = np.full((n, k, 3), np.nan)
    found = epsilon_batch(
        empty, empty, np.zeros((n, k), bool), friction=0.8, torsion=0.003, torque_scale=0.05,
        origin=np.zeros(3),
    )  # fmt: skip
    assert np.isnan(found.upper).all()
    assert len(found.upper) == n
