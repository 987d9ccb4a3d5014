"""Orientation, winding numbers, and solids made of open surfaces."""

import numpy as np
import pytest
import trimesh

from gmdx.objects.repair.read import is_consistent
from gmdx.objects.repair.solid import misfit, thicken
from gmdx.objects.repair.winding import consistent_faces, signed_volumes, winding_number
from gmdx.objects.surface import surface_samples


def two_balls(apart: float) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.concatenate([ball.vertices, ball.vertices + np.array([apart, 0, 0])])
    return vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)])


def test_winding_numbers_count_how_often_a_point_is_inside() -> None:
    vertices, faces = two_balls(1.0)
    points = np.array([[-0.5, 0, 0], [0.5, 0, 0], [1.5, 0, 0], [5.0, 0, 0], [0.5, 0, 0.95]])
    found = winding_number(points, vertices[faces])
    assert found == pytest.approx([1, 2, 1, 0, 0], abs=1e-9)
    assert winding_number(points, vertices[faces[:, ::-1]]) == pytest.approx(-found, abs=1e-9)


def test_half_a_box_winds_half_around_its_middle() -> None:
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    half = np.asarray(box.triangles)[(box.face_normals > 0.5).any(axis=1)]
    assert winding_number(np.zeros((1, 3)), half)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("apart", [0.5, 1.0, 1.8])
def test_misfit_is_the_share_that_lies_inside_the_other(apart: float) -> None:
    """Of two unit balls, the caps within each other are (1 - apart / 2) / 2 of the area."""
    vertices, faces = two_balls(apart)
    expected = (1 - apart / 2) / 2
    assert misfit(vertices, faces) == pytest.approx(expected, abs=0.03)
    triangles = vertices[faces]
    points, owner = surface_samples(triangles, 400, np.random.default_rng(0))
    normal = np.cross(*np.moveaxis(triangles[owner][:, 1:] - triangles[owner][:, :1], 1, 0))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outside = winding_number(points + 1e-6 * normal, triangles)  # the same by solid angles
    assert misfit(vertices, faces) == pytest.approx((np.abs(outside) > 0.5).mean(), abs=0.03)


def test_misfit_of_a_proper_and_of_an_inside_out_surface() -> None:
    vertices, faces = two_balls(3.0)
    assert misfit(vertices, faces) == 0.0
    assert misfit(vertices, faces[:, ::-1].copy()) == 1.0


def test_faces_agree_after_turning_and_parts_keep_their_first_face() -> None:
    vertices, faces = two_balls(3.0)
    mixed = faces.copy()
    some = np.random.default_rng(0).random(len(faces)) < 0.4
    mixed[some] = mixed[some][:, ::-1]
    fixed, turned = consistent_faces(mixed)
    assert is_consistent(fixed)
    half = len(faces) // 2
    assert not turned[0]
    assert not turned[half]
    part = (np.arange(len(faces)) >= half).astype(int)
    ball = trimesh.creation.icosphere(subdivisions=2).volume
    assert np.abs(signed_volumes(vertices, fixed, part)) == pytest.approx([ball, ball])


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_a_closed_surface_stays_where_it_is(subdivisions: int) -> None:
    """Though nothing says which side is in: shuffled windings, torn into single triangles."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    solid = thicken(ball.vertices, np.asarray(ball.faces), thickness=0.03)
    made = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert made.volume == pytest.approx(ball.volume, rel=5e-4)
    assert made.bounds == pytest.approx(ball.bounds, abs=1e-3)
    assert (solid.filled, solid.sheet_share) == (1, 0.0)


@pytest.mark.parametrize("thickness", [0.01, 0.05, 0.1])
def test_a_sheet_gets_the_thickness_asked_for(thickness: float) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 2, 7), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    faces = np.array(
        [t for i in range(4) for j in range(6) for a in [7 * i + j]
         for t in ([a, a + 7, a + 1], [a + 1, a + 7, a + 8])]
    )  # fmt: skip
    solid = thicken(vertices, faces, thickness=thickness)
    volume = signed_volumes(solid.vertices, solid.faces, np.zeros(len(solid.faces), int))[0]
    assert volume == pytest.approx(2 * thickness, rel=1e-6)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx([1, 2, thickness], rel=1e-6)
    assert solid.sheet_share == 1.0
