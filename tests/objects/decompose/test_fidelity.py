"""Distances and volumes against closed forms and against brute force."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from gmdx.objects.decompose.fidelity import FidelityConfig, measure_fidelity, union_of_hulls
from gmdx.objects.surface import SurfaceIndex, surface_samples, triangle_distance


def index(mesh: trimesh.Trimesh, n: int = 10_000) -> SurfaceIndex:
    return SurfaceIndex(np.array(mesh.vertices), np.array(mesh.faces), n=n, seed=0)


def box(*extents: float, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(at)
    return mesh


def test_samples_are_spread_by_area_and_lie_on_their_triangle() -> None:
    mesh = box(0.01, 0.02, 0.03)
    points, owner = surface_samples(np.array(mesh.triangles), 6000, np.random.default_rng(0))
    share = np.bincount(owner, minlength=12) / 6000
    np.testing.assert_allclose(share, mesh.area_faces / mesh.area, atol=1 / 6000 + 1e-12)
    assert triangle_distance(points, np.array(mesh.triangles)[owner]).max() < 1e-12
    # Uniform within a triangle: the mean is its centroid.
    mine = points[owner == 0]
    spread = mine.std(axis=0).max() / np.sqrt(len(mine))
    np.testing.assert_allclose(mine.mean(axis=0), mesh.triangles_center[0], atol=4 * spread)


def test_triangle_distance_agrees_with_a_dense_grid_of_its_points() -> None:
    rng = np.random.default_rng(1)
    triangles, points = rng.normal(size=(60, 3, 3)), 2 * rng.normal(size=(60, 3))
    u, v = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201))
    keep = u + v <= 1
    weights = np.stack([1 - u - v, u, v], axis=-1)[keep]
    on = np.einsum("gk,tkx->tgx", weights, triangles)
    brute = np.linalg.norm(on - points[:, None], axis=2).min(axis=1)
    exact = triangle_distance(points, triangles)
    assert (exact <= brute + 1e-12).all()
    assert (brute - exact).max() < 0.05


def test_a_degenerate_triangle_is_a_segment() -> None:
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    assert triangle_distance(np.array([[3.0, 0, 1]]), triangle)[0] == pytest.approx(np.sqrt(2))


def test_a_box_around_a_box_is_as_far_away_as_it_is_larger() -> None:
    inner, outer = box(0.04, 0.05, 0.06), box(0.042, 0.052, 0.062)
    found = measure_fidelity([np.array(outer.vertices)], index(inner), inner.volume)
    assert found.volume_ratio == pytest.approx(outer.volume / inner.volume, rel=1e-6)
    for value in (found.from_surface.mean, found.from_surface.p95, found.from_surface.max):
        assert value == pytest.approx(1e-3, abs=1e-8)
    assert 0.99999e-3 <= found.to_surface.mean < 1.02e-3  # a little more along the edges
    assert found.to_surface.max <= np.sqrt(3) * 1.0001e-3


def test_the_same_box_in_two_touching_halves_has_no_inner_wall() -> None:
    whole = box(0.04, 0.04, 0.04)
    halves = [box(0.02, 0.04, 0.04, at=(x, 0, 0)) for x in (-0.01, 0.01)]
    found = measure_fidelity([np.array(h.vertices) for h in halves], index(whole), whole.volume)
    assert found.volume_ratio == pytest.approx(1, abs=1e-6)
    assert max(found.to_surface.max, found.from_surface.max) < 1e-8


def test_a_filled_cavity_is_seen_from_the_surface_and_an_extra_part_from_the_hulls() -> None:
    solid = box(0.04, 0.04, 0.04)
    hollow = trimesh.boolean.difference([solid, box(0.02, 0.02, 0.02)], engine="manifold")
    filled = measure_fidelity([np.array(solid.vertices)], index(hollow), hollow.volume)
    assert filled.volume_ratio == pytest.approx(8 / 7, rel=1e-6)
    assert filled.to_surface.max < 1e-8
    assert filled.from_surface.max == pytest.approx(0.01, rel=1e-6)
    extra = box(0.01, 0.01, 0.01, at=(0.025, 0, 0))
    parts = [np.array(solid.vertices), np.array(extra.vertices)]
    found = measure_fidelity(parts, index(solid), solid.volume)
    assert found.to_surface.max == pytest.approx(0.01, rel=1e-6)


def test_volume_of_the_union_agrees_with_counting_random_points() -> None:
    rng = np.random.default_rng(2)
    hulls = [rng.normal(size=(12, 3)) * 0.01 + rng.normal(size=3) * 0.008 for _ in range(6)]
    vertices, faces, volume = union_of_hulls(hulls)
    low, high = np.concatenate(hulls).min(axis=0), np.concatenate(hulls).max(axis=0)
    points = rng.uniform(low, high, size=(100_000, 3))
    inside = np.any([Delaunay(h).find_simplex(points) >= 0 for h in hulls], axis=0)
    share, space = inside.mean(), float(np.prod(high - low))
    error = np.sqrt(share * (1 - share) / len(points))
    assert volume / space == pytest.approx(share, abs=4 * error)
    # The boundary's own volume, by the divergence theorem.
    a, b, c = vertices[faces].transpose(1, 0, 2)
    assert np.sum(np.cross(a, b) * c) / 6 == pytest.approx(volume, rel=1e-6)


def test_distances_agree_with_every_triangle_tried() -> None:
    mesh = trimesh.creation.torus(0.02, 0.006, major_sections=24, minor_sections=12)
    points = np.random.default_rng(3).normal(size=(400, 3)) * 0.02
    triangles = np.array(mesh.triangles)
    every = np.min(
        [triangle_distance(points, np.repeat(t[None], 400, axis=0)) for t in triangles], axis=0
    )
    found = index(mesh).distance(points)
    assert (found >= every - 1e-12).all()
    assert (found - every).max() < 1e-5


def test_the_measure_does_not_depend_on_the_number_of_samples_or_on_chance() -> None:
    mesh = trimesh.creation.cylinder(0.02, 0.06)
    rough = np.array(trimesh.creation.cylinder(0.0205, 0.06, sections=8).vertices)
    few, many = (
        measure_fidelity(
            [rough], index(mesh, n), mesh.volume, config=FidelityConfig(samples=n, seed=n)
        )
        for n in (10_000, 100_000)
    )
    assert few.to_surface.p95 == pytest.approx(many.to_surface.p95, rel=0.03)
    assert few.from_surface.p95 == pytest.approx(many.from_surface.p95, rel=0.03)
