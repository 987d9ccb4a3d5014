"""Hulls against shapes whose best decomposition is known, and what happens when CoACD fails."""

import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, Delaunay

from gmdx.errors import DecompositionError
from gmdx.objects.decompose.coacd_process import CoacdFailure, run_coacd
from gmdx.objects.decompose.decomposition import Attempt, DecomposeConfig, Decomposition, decompose
from gmdx.objects.decompose.hulls import (
    grow_hull,
    hull_node,
    merge_sequence,
    simplify_hull,
    trim_hulls,
)
from gmdx.objects.repair.read import read_mesh
from gmdx.objects.repair.repairing import repair

SHARED = Path(__file__).parents[3].parent / "shared" / "objects"


def box(*extents: float, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(at)
    return mesh


def l_profile() -> trimesh.Trimesh:
    arms = [box(0.04, 0.01, 0.05), box(0.01, 0.04, 0.05, at=(-0.015, 0.015, 0))]
    return trimesh.boolean.union(arms, engine="manifold")


def cross() -> trimesh.Trimesh:
    return trimesh.boolean.union([box(0.06, 0.012, 0.012), box(0.012, 0.06, 0.012)])


def cup(radius: float = 0.022, wall: float = 0.0015, height: float = 0.05) -> trimesh.Trimesh:
    inner = radius - wall
    profile = [[0, 0], [radius, 0], [radius, height], [inner, height], [inner, wall], [0, wall]]
    return trimesh.creation.revolve(profile, sections=32)


def inside_any(points: np.ndarray, hulls: tuple[np.ndarray, ...]) -> np.ndarray:
    inside: np.ndarray = np.any([Delaunay(h).find_simplex(points) >= 0 for h in hulls], axis=0)
    return inside


def compile_hulls(hulls: tuple[np.ndarray, ...]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=0.1, inertia=[1e-5] * 3, explicitinertial=True)
    body.add_freejoint()
    for i, hull in enumerate(hulls):
        spec.add_mesh(name=f"hull{i}", uservert=hull.ravel())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull{i}")
    return spec.compile()


@pytest.fixture(scope="module")
def decomposed_cup() -> Decomposition:
    return decompose(cup())


def test_a_box_is_its_own_single_hull() -> None:
    mesh = box(0.03, 0.04, 0.09)
    found = decompose(mesh)
    assert len(found.hulls) == 1
    assert sorted(map(tuple, found.hulls[0])) == sorted(map(tuple, np.array(mesh.vertices)))
    assert found.report["method"] == "convex hull"
    assert found.report["fallback"] is None
    assert found.report["within_bounds"]
    assert found.report["surface_to_hulls_mm"]["max"] < 1e-4


@pytest.mark.parametrize(("shape", "most"), [(l_profile, 2), (cross, 3)])
def test_prismatic_solids_need_few_hulls_and_keep_their_volume(shape, most) -> None:  # type: ignore[no-untyped-def]
    mesh = shape()
    found = decompose(mesh)
    assert 2 <= len(found.hulls) <= most
    assert found.report["kind"] == "solid"
    assert found.report["within_bounds"]
    assert found.report["volume_ratio"] == pytest.approx(1, abs=0.01)
    for direction in ("hulls_to_surface_mm", "surface_to_hulls_mm"):
        assert found.report[direction]["p95"] < 0.1
    # Independently of the report: random points are inside a hull where inside the mesh.
    points = np.random.default_rng(0).uniform(*mesh.bounds, size=(4000, 3))
    wrong = inside_any(points, found.hulls) != mesh_contains(mesh, points)
    assert wrong.mean() < 0.01
    json.dumps(found.report)


def mesh_contains(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Winding number by solid angles of all triangles (Van Oosterom and Strackee 1983)."""
    a, b, c = (np.asarray(mesh.triangles)[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    above = np.einsum("ptk,ptk->pt", a, np.cross(b, c))
    dots = [np.einsum("ptk,ptk->pt", x, y) for x, y in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    winding: np.ndarray = np.arctan2(above, below).sum(axis=1) / (2 * np.pi)
    return winding > 0.5


def test_a_ball_keeps_its_volume_with_few_vertices() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.025)
    found = decompose(mesh)
    assert len(found.hulls) == 1
    assert len(found.hulls[0]) <= DecomposeConfig().max_vertices
    assert ConvexHull(found.hulls[0]).volume == pytest.approx(4 / 3 * np.pi * 0.025**3, rel=0.01)
    assert found.report["hulls_to_surface_mm"]["p95"] < 0.5


def test_a_cup_stays_hollow(decomposed_cup: Decomposition) -> None:
    report = decomposed_cup.report
    assert report["kind"] == "shell"
    assert report["bounds"]["volume"] is None
    assert report["within_bounds"]
    assert report["volume_ratio"] < 1.5
    # A cylinder a little narrower than the hollow, down to a little above the floor, is free.
    rng = np.random.default_rng(0)
    r, t = 0.016 * np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    points = np.stack([r * np.cos(t), r * np.sin(t), rng.uniform(0.006, 0.06, 4000)], axis=1)
    assert not inside_any(points, decomposed_cup.hulls).any()
    floor = np.array([[0, 0, 0.0008]])
    assert inside_any(floor, decomposed_cup.hulls).all()


def test_physics_takes_every_hull(decomposed_cup: Decomposition) -> None:
    model = compile_hulls(decomposed_cup.hulls)
    assert model.nmesh == len(decomposed_cup.hulls)
    assert max(len(h) for h in decomposed_cup.hulls) <= DecomposeConfig().max_vertices


def test_a_fine_mesh_is_decomposed_from_a_copy_of_known_deviation() -> None:
    mesh = trimesh.creation.torus(0.018, 0.006, major_sections=128, minor_sections=48)
    assert len(mesh.faces) > 3000
    found = decompose(mesh)
    assert found.report["simplified_faces"] <= 3000
    assert 0 < found.report["simplified_deviation_mm"] < 0.4
    assert found.report["within_bounds"]
    assert not inside_any(np.zeros((1, 3)), found.hulls).any()


def test_the_same_mesh_gives_the_same_bytes() -> None:
    first, second = (decompose(cross()) for _ in range(2))
    assert [h.tobytes() for h in first.hulls] == [h.tobytes() for h in second.hulls]
    first.report.pop("seconds"), second.report.pop("seconds")
    assert first.report == second.report


def test_a_hull_too_far_off_says_by_how_much() -> None:
    mesh = trimesh.creation.torus(0.018, 0.005)
    found = decompose(mesh, config=DecomposeConfig(max_hulls=3))
    assert len(found.hulls) <= 3
    assert not found.report["within_bounds"]
    missed = [found.report[d]["p95"] - 1 for d in ("hulls_to_surface_mm", "surface_to_hulls_mm")]
    missed.append(abs(found.report["volume_ratio"] - 1) / 0.05 - 1)
    assert found.report["miss"] == pytest.approx(max(missed), rel=1e-4)
    assert found.report["fallback"] is None


def test_out_of_time_ends_in_the_named_fallback(caplog: pytest.LogCaptureFixture) -> None:
    mesh = trimesh.creation.torus(0.018, 0.006, major_sections=48, minor_sections=24)
    hopeless = Attempt(2e-5, 1.0)
    found = decompose(mesh, config=DecomposeConfig(attempts=(hopeless,), rescue=hopeless))
    assert found.report["fallback"] == "convex hull"
    assert "CPU time" in found.report["attempts"][0]["failure"]
    assert len(found.hulls) == 1
    assert not found.report["within_bounds"]
    assert "convex hull stands in" in caplog.text


def test_a_coarser_attempt_comes_to_the_rescue() -> None:
    mesh = trimesh.creation.torus(0.018, 0.006, major_sections=48, minor_sections=24)
    found = decompose(mesh, config=DecomposeConfig(attempts=(Attempt(2e-5, 1.0),)))
    assert found.report["fallback"] is None
    assert len(found.report["attempts"]) == 2
    assert not inside_any(np.zeros((1, 3)), found.hulls).any()


def test_a_crash_of_coacd_is_a_failure_and_not_ours() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 1_000_000_000]])
    with pytest.raises(CoacdFailure, match="exit status"):
        run_coacd(np.eye(3), faces, threshold=1e-3, seconds=5.0)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up in /proc")
def test_killing_the_parent_ends_coacd() -> None:
    script = (
        "import trimesh; from gmdx.objects.decompose.coacd_process import run_coacd;"
        "m = trimesh.creation.torus(0.018, 0.006, major_sections=64, minor_sections=32);"
        "run_coacd(m.vertices, m.faces, threshold=1e-5, seconds=60.0)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script])

    def children() -> list[int]:
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rsplit(")", 1)[1].split()
            except OSError:  # it ended meanwhile
                continue
            if int(fields[1]) == parent.pid and fields[0] != "Z":
                found.append(int(stat.parent.name))
        return found

    def wait(until) -> bool:  # type: ignore[no-untyped-def]
        end = time.monotonic() + 60
        while time.monotonic() < end:
            if until():
                return True
            time.sleep(0.1)
        return False

    assert wait(children)
    time.sleep(2)  # past its imports, into CoACD
    (child,) = children()
    parent.kill()
    parent.wait()

    def gone() -> bool:
        try:
            return " Z " in Path(f"/proc/{child}/stat").read_text()
        except OSError:
            return True

    ended = wait(gone)
    if not ended:
        os.kill(child, 9)
    assert ended


def test_it_runs_inside_a_daemonic_worker() -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.apply(decompose, (l_profile(),))
    assert len(found.hulls) == 2


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.Trimesh(),
        trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [[0, 1, 2], [0, 2, 1]]),
        trimesh.Trimesh(
            trimesh.creation.box().vertices, trimesh.creation.box().faces[:, ::-1], process=False
        ),
    ],
    ids=["empty", "flat", "inside out"],
)
def test_a_mesh_without_volume_is_refused(mesh: trimesh.Trimesh) -> None:
    with pytest.raises(DecompositionError, match="encloses no volume"):
        decompose(mesh)


def test_simplifying_leaves_out_only_what_sticks_out_less_than_the_tolerance() -> None:
    node = hull_node(np.random.default_rng(0).normal(size=(400, 3)) * 0.02)
    assert node is not None
    points = simplify_hull(node, tolerance=5e-4, max_vertices=1000, restore=False)
    assert 4 <= len(points) < len(node.points)
    planes = ConvexHull(points).equations
    outside = (node.points @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    assert outside.max() <= 5e-4
    restored = simplify_hull(node, tolerance=5e-4, max_vertices=1000)
    assert ConvexHull(restored).volume == pytest.approx(node.volume, rel=1e-9)


def test_growing_moves_facets_outward_by_the_margin() -> None:
    grown = grow_hull(np.array(box(0.02, 0.03, 0.04).vertices), 1e-4)
    np.testing.assert_allclose(np.ptp(grown, axis=0), [0.0202, 0.0302, 0.0402], atol=1e-5)


def test_trimming_moves_in_the_outside_and_leaves_the_inside() -> None:
    halves = [np.array(box(0.0201, 0.04, 0.04, at=(x, 0, 0)).vertices) for x in (-0.01, 0.01)]
    trimmed = trim_hulls(halves, 1e-4, probe=2e-5)
    low, high = np.min(trimmed, axis=(0, 1)), np.max(trimmed, axis=(0, 1))
    np.testing.assert_allclose(high - low, [0.0399, 0.0398, 0.0398], atol=2e-5)
    assert trimmed[0][:, 0].max() > trimmed[1][:, 0].min()


def test_merging_starts_where_it_adds_nothing() -> None:
    halves = [box(0.02, 0.02, 0.02, at=(x, 0, 0)) for x in (-0.01, 0.01)]
    aside = box(0.02, 0.02, 0.02, at=(0.01, 0.02, 0))
    nodes = tuple(hull_node(np.array(m.vertices)) for m in (halves[0], aside, halves[1]))
    sequence = merge_sequence(nodes, gap=1e-3)  # type: ignore[arg-type]
    assert sequence.after(0) == (0, 1, 2)
    assert set(sequence.pairs[0]) in ({0, 2}, {1, 2})
    assert len(sequence.after(len(sequence.pairs))) == 1
    assert sequence.nodes[3].volume == pytest.approx(16e-6)
    assert sequence.nodes[4].volume == pytest.approx(28e-6)  # the L's convex hull


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the scans in shared/objects are not here")
@pytest.mark.parametrize(
    "name", ["kit/CeylonTea_800_tex", "kit/MelforBottle_800_tex", "kit/GreenCup_800_tex"]
)
def test_scans(name: str) -> None:
    mesh = repair(read_mesh(SHARED / f"{name}.obj")).mesh
    found = decompose(mesh)
    assert found.report["within_bounds"]
    assert found.report["kind"] == ("shell" if "Cup" in name else "solid")
    # Counted, not measured: points inside a hull against points inside the mesh.
    points = np.random.default_rng(0).uniform(*mesh.bounds, size=(3000, 3))
    filled, solid = inside_any(points, found.hulls).mean(), mesh_contains(mesh, points).mean()
    error = np.sqrt(2 * filled * (1 - filled) / len(points))
    assert filled / solid == pytest.approx(found.report["volume_ratio"], abs=4 * error / solid)
