import numpy as np
import pytest
import trimesh

from gmdx_kernels.closing_lines import closing_lines, pad_grid

UP = np.array([0.0, 0.0, 1.0])


def _crossings(
    corners: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances and entering flags of all crossings of one line (Moller and Trumbore)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    det = (edge1 * p).sum(axis=1)
    keep = np.abs(det) > 1e-18
    edge1, edge2, p, det, base = edge1[keep], edge2[keep], p[keep], det[keep], corners[keep, 0]
    s = origin - base
    u = (s * p).sum(axis=1) / det
    q = np.cross(s, edge1)
    v = (q @ direction) / det
    t = (edge2 * q).sum(axis=1) / det
    hit = (u >= 0) & (v >= 0) & (u + v <= 1)
    normal = np.cross(edge1, edge2)
    return t[hit], (normal[hit] @ direction) < 0


def _twin(
    corners: np.ndarray, center: np.ndarray, axis: np.ndarray, half: float
) -> tuple[float, float]:
    """First touches of both fingers on one line, by sorting every crossing."""
    touches = []
    for sign in (1.0, -1.0):
        t, enters = _crossings(corners, center, sign * axis)
        inside = np.abs(t) <= half
        t, enters = t[inside], enters[inside]
        first = t.argmin() if len(t) else None
        touches.append(sign * t[first] if first is not None and enters[first] else np.nan)
    return touches[0], touches[1]


def _meshes() -> dict[str, trimesh.Trimesh]:
    torus = trimesh.creation.torus(major_radius=0.03, minor_radius=0.01)
    tube = trimesh.creation.annulus(r_min=0.02, r_max=0.025, height=0.06)
    knot = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    rng = np.random.default_rng(0)
    knot.vertices *= 1 + 0.2 * rng.standard_normal((len(knot.vertices), 1))
    return {"torus": torus, "tube": tube, "knot": knot}


@pytest.mark.parametrize("name", ["torus", "tube", "knot"])
def test_agrees_with_sorting_every_crossing(name: str) -> None:
    mesh = _meshes()[name]
    rng = np.random.default_rng(1)
    n = 40
    angle = rng.uniform(0, np.pi, n)
    axis = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    up = np.tile(UP, (n, 1))
    center = rng.uniform(-0.03, 0.03, (n, 3))
    width = rng.uniform(0.005, 0.1, n)
    offsets = pad_grid(np.array([0.02, 0.015]), (4, 3))
    found = closing_lines(
        np.array(mesh.vertices), np.array(mesh.faces), center, axis, up, width, offsets=offsets
    )
    corners = np.array(mesh.triangles)
    expected = np.empty((n, 2, len(offsets)))
    for i in range(n):
        across = np.cross(UP, axis[i])
        for j, (y, z) in enumerate(offsets):
            origin = center[i] + y * across + z * UP
            expected[i, :, j] = _twin(corners, origin, axis[i], width[i] / 2)
    np.testing.assert_allclose(found.distance, expected, atol=1e-10)
    assert (np.isfinite(found.distance) == (found.triangle >= 0)).all()
    assert 0.1 < np.isfinite(expected).mean() < 0.95  # the case is worth testing


def test_box_is_met_at_its_faces_also_through_edges_of_triangles() -> None:
    box = trimesh.creation.box((0.04, 0.06, 0.02))
    offsets = np.array([[0.0, 0.0], [0.01, 0.01 / 3], [-0.015, -0.005], [0.03, 0.0], [0.031, 0.0]])
    found = closing_lines(
        np.array(box.vertices),
        np.array(box.faces),
        np.array([[0.005, 0.0, 0.0]]),
        np.array([[1.0, 0.0, 0.0]]),
        UP[None],
        np.array([0.08]),
        offsets=offsets,
    )
    np.testing.assert_allclose(found.distance[0, 0, :3], -0.025, atol=1e-15)
    np.testing.assert_allclose(found.distance[0, 1, :3], 0.015, atol=1e-15)
    assert np.isnan(found.distance[0, :, 4]).all()


def test_no_line_leaks_through_vertices_and_edges() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    middles = vertices[mesh.edges_unique].mean(axis=1)
    targets = np.concatenate([vertices, middles])
    targets = targets[np.hypot(targets[:, 1], targets[:, 2]) < 0.028]
    found = closing_lines(
        vertices,
        faces,
        np.zeros((1, 3)),
        np.array([[1.0, 0.0, 0.0]]),
        UP[None],
        np.array([0.1]),
        offsets=targets[:, 1:],
    )
    assert np.isfinite(found.distance).all()
    side = (targets[:, 0] > 0).astype(int)
    mine = np.take_along_axis(found.distance[0], side[None], axis=0)[0]
    np.testing.assert_allclose(mine, targets[:, 0], atol=1e-9)


def test_finger_inside_the_solid_touches_nothing() -> None:
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    found = closing_lines(
        np.array(box.vertices),
        np.array(box.faces),
        np.array([[0.0, 0.0, 0.0], [0.015, 0.0, 0.0], [0.1, 0.0, 0.0]]),
        np.array([[1.0, 0.0, 0.0]] * 3),
        np.array([UP] * 3),
        np.array([0.03, 0.05, 0.05]),
        offsets=np.array([[0.001, 0.002]]),
    )
    # Both fingers inside; finger 0 inside and finger 1 outside; neither meets anything.
    np.testing.assert_allclose(
        found.distance[:, :, 0], [[np.nan, np.nan], [np.nan, 0.005], [np.nan, np.nan]], atol=1e-15
    )


def test_pad_grid_covers_the_face_evenly() -> None:
    offsets = pad_grid(np.array([0.02, 0.01]), (4, 5))
    assert offsets.shape == (20, 2)
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=1e-18)
    np.testing.assert_allclose(offsets.min(axis=0), [-0.01, -0.005])
    np.testing.assert_allclose(offsets.max(axis=0), [0.01, 0.005])
    np.testing.assert_allclose(np.diff(np.unique(offsets[:, 1])), 0.0025)
    np.testing.assert_array_equal(pad_grid(np.array([0.02, 0.01]), (1, 1)), [[0.0, 0.0]])
