"""Closed forms of what each kind of damaged mesh is once it is repaired."""

import numpy as np
import pytest
import trimesh

from gmdx.errors import MeshError
from gmdx.objects.repair.read import as_trimesh, is_closed, is_consistent
from gmdx.objects.repair.repairing import RepairConfig, RepairedMesh, repair
from gmdx.objects.repair.winding import winding_number


def box_at(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, size: float = 1.0) -> trimesh.Trimesh:
    box = trimesh.creation.box([size] * 3)
    box.apply_translation([x, y, z])
    return box


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """All triangles in one mesh, nothing merged."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [np.asarray(m.faces) + o for m, o in zip(meshes, offsets, strict=False)]
    return as_trimesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return as_trimesh(mesh.vertices, np.asarray(mesh.faces)[:, ::-1])


def steps(repaired: RepairedMesh) -> set[str]:
    return {step.name for step in repaired.steps}


def assert_proper(repaired: RepairedMesh) -> None:
    faces = np.asarray(repaired.mesh.faces)
    assert is_closed(faces)
    assert is_consistent(faces)
    assert repaired.misfit < 0.02
    assert repaired.mesh.volume > 0


def test_a_good_mesh_is_left_alone() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    repaired = repair(ball)
    assert repaired.steps == ()
    assert repaired.watertight_source
    assert repaired.mesh.volume == pytest.approx(ball.volume, rel=1e-12)


def test_inside_out_is_turned() -> None:
    repaired = repair(turned(box_at()))
    assert repaired.mesh.volume == pytest.approx(1.0)
    assert "turn inside-out parts" in steps(repaired)


def test_faces_wound_at_random_are_made_to_agree() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = np.asarray(ball.faces).copy()
    some = np.random.default_rng(1).random(len(faces)) < 0.5
    faces[some] = faces[some][:, ::-1]
    repaired = repair(as_trimesh(ball.vertices, faces))
    assert_proper(repaired)
    assert repaired.mesh.volume == pytest.approx(ball.volume, rel=1e-12)


def test_collapsed_and_double_faces_go() -> None:
    box = box_at()
    faces = np.concatenate([box.faces, box.faces[:3], [[0, 0, 1]]])
    repaired = repair(as_trimesh(box.vertices, faces))
    assert steps(repaired) == {"drop collapsed faces", "drop faces that are there twice"}
    assert repaired.mesh.volume == pytest.approx(1.0)


def test_a_small_hole_is_filled() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    around = np.flatnonzero((np.asarray(ball.faces) == 0).any(axis=1))
    holed = as_trimesh(ball.vertices, np.delete(np.asarray(ball.faces), around, axis=0))
    repaired = repair(holed)
    assert_proper(repaired)
    assert not repaired.watertight_source
    assert "fill holes" in steps(repaired)
    assert repaired.mesh.volume == pytest.approx(ball.volume, rel=2e-3)


def test_holes_that_touch_at_a_vertex_are_filled() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    faces = np.asarray(ball.faces)
    at = np.flatnonzero((faces == 0).any(axis=1))
    holed = as_trimesh(ball.vertices, np.delete(faces, at[[0, 2]], axis=0))
    repaired = repair(holed)
    assert_proper(repaired)
    assert repaired.mesh.volume == pytest.approx(ball.volume, rel=1e-2)


@pytest.mark.parametrize("seed", range(4))
def test_a_scan_with_lost_triangles_is_made_whole(seed: int) -> None:
    """A ring of square section without 4 % of its triangles, long thin ones among them."""
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    section = [[3.0, -1.0], [4.0, -1.0], [4.0, 1.0], [3.0, 1.0]]
    vertices = np.array([[r * np.cos(t), r * np.sin(t), z] for t in angles for r, z in section])
    faces = []
    for i in range(40):
        for k in range(4):
            a, b = 4 * i + k, 4 * i + (k + 1) % 4
            c, d = (a + 4) % 160, (b + 4) % 160
            faces += [[a, c, b], [b, c, d]]
    ring = as_trimesh(vertices, np.array(faces))
    lost = np.random.default_rng(seed).random(len(ring.faces)) < 0.04
    repaired = repair(as_trimesh(vertices, np.asarray(ring.faces)[~lost]))
    assert_proper(repaired)
    assert repaired.mesh.volume == pytest.approx(abs(ring.volume), rel=0.01)


@pytest.mark.parametrize("reverse", [False, True])
def test_an_open_bowl_becomes_a_thin_shell(reverse: bool) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    faces = np.asarray(ball.faces)[ball.triangles_center[:, 2] < 0]
    bowl = as_trimesh(ball.vertices, faces[:, ::-1] if reverse else faces)
    repaired = repair(bowl)
    assert_proper(repaired)
    diagonal = np.linalg.norm([2.0, 2.0, 1.0])
    thickness = RepairConfig().shell * diagonal
    assert repaired.mesh.volume == pytest.approx(bowl.area * thickness, rel=0.05)
    inside = winding_number(np.array([[0.0, 0.0, -0.5], [0.0, 0.0, -1.0]]), repaired.mesh.triangles)
    assert np.allclose(inside, [0, 1], atol=1e-6)  # the middle is empty, the wall is not


def test_a_box_without_lid_stays_hollow() -> None:
    box = box_at()
    lidless = as_trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5])
    repaired = repair(lidless)
    assert_proper(repaired)
    assert winding_number(np.zeros((1, 3)), repaired.mesh.triangles)[0] == pytest.approx(
        0, abs=1e-9
    )
    thickness = RepairConfig().shell * 3**0.5
    assert repaired.mesh.volume == pytest.approx(5 * thickness, rel=0.1)


def test_overlapping_parts_are_united() -> None:
    repaired = repair(joined(box_at(), turned(box_at(0.5, 0.5, 0.5))))
    assert_proper(repaired)
    assert repaired.bodies == 1
    assert repaired.mesh.volume == pytest.approx(2 - 1 / 8)


def test_separate_parts_stay_separate() -> None:
    repaired = repair(joined(box_at(), box_at(3.0)))
    assert_proper(repaired)
    assert repaired.bodies == 2
    assert repaired.mesh.volume == pytest.approx(2.0)


@pytest.mark.parametrize("all_turned", [False, True])
def test_a_part_wound_against_its_container_is_a_void(all_turned: bool) -> None:
    hollow = joined(box_at(), turned(box_at(size=0.5)), box_at(size=0.2))
    repaired = repair(turned(hollow) if all_turned else hollow)
    assert_proper(repaired)
    assert repaired.mesh.volume == pytest.approx(1 - 1 / 8 + 1 / 125)


def test_a_part_inside_another_is_absorbed() -> None:
    repaired = repair(joined(box_at(), box_at(size=0.5)))
    assert repaired.mesh.volume == pytest.approx(1.0)


def test_debris_is_dropped() -> None:
    repaired = repair(joined(box_at(), box_at(1.5, size=0.05)))
    assert repaired.bodies == 1
    assert "drop debris" in steps(repaired)
    assert repaired.mesh.extents == pytest.approx([1, 1, 1])


def test_a_fin_on_a_box_becomes_a_shell_on_a_solid() -> None:
    box = box_at()
    edge = np.flatnonzero((box.vertices[:, 1] > 0) & (box.vertices[:, 2] > 0))
    tip = len(box.vertices) + np.arange(2)
    fin = [[edge[0], edge[1], tip[0]], [edge[1], tip[1], tip[0]]]
    vertices = np.concatenate([box.vertices, box.vertices[edge] + [0.0, 0.0, 1.0]])
    repaired = repair(as_trimesh(vertices, np.concatenate([box.faces, fin])))
    assert_proper(repaired)
    thickness = RepairConfig().shell * np.linalg.norm([1.0, 1.0, 2.0])
    assert repaired.mesh.volume == pytest.approx(1 + thickness, rel=5e-3)
    inside = winding_number(np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 1.0]]), repaired.mesh.triangles)
    assert np.allclose(inside, 1, atol=1e-6)


def test_boxes_that_share_an_edge_stay_as_they_are() -> None:
    repaired = repair(joined(box_at(), box_at(1.0, 1.0)))
    assert "part what touches" in steps(repaired)
    assert is_closed(np.asarray(repaired.mesh.faces))
    assert repaired.mesh.volume == pytest.approx(2.0, rel=1e-9)


def test_plates_around_a_space_leave_it_empty() -> None:
    """Six overlapping plates, closed each, with hair-thin gaps to nowhere: the inside is air."""
    plates = []
    for axis in range(3):
        for side in (-1, 1):
            extents, place = np.full(3, 0.98), np.zeros(3)
            extents[axis], place[axis] = 0.1, 0.5 * side
            plate = trimesh.creation.box(extents)
            plate.apply_translation(place)
            plates.append(plate)
    repaired = repair(joined(*plates))
    assert is_closed(np.asarray(repaired.mesh.faces))
    twice, thrice = 12 * 0.04**2 * 0.98, 8 * 0.04**3  # in two plates at the edges, three at corners
    assert repaired.mesh.volume == pytest.approx(6 * 0.1 * 0.98**2 - twice + thrice)


def coil(angle: float) -> trimesh.Trimesh:
    """A bar of unit cross-section bent round by `angle` rad at radius 4: past 2 pi, into itself."""
    turns = np.linspace(0, angle, 80)
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    ring = [[(4 + r) * np.cos(t), (4 + r) * np.sin(t), z] for t in turns for r, z in square]
    faces = [[0, 1, 2], [0, 2, 3]]
    for i in range(len(turns) - 1):
        for k in range(4):
            a, b = 4 * i + k, 4 * i + (k + 1) % 4
            faces += [[a, a + 4, b], [b, a + 4, b + 4]]
    end = 4 * (len(turns) - 1)
    faces += [[end, end + 2, end + 1], [end, end + 3, end + 2]]
    return as_trimesh(np.array(ring), np.array(faces))


def test_a_surface_that_passes_through_itself_is_rebuilt() -> None:
    mesh = coil(np.radians(440.0))
    assert abs(mesh.volume) > 1.2 * 2 * np.pi * 4  # the overlap counts twice
    repaired = repair(mesh)
    assert "found self-intersection" in steps(repaired)
    assert_proper(repaired)
    assert repaired.mesh.volume == pytest.approx(2 * np.pi * 4, rel=0.02)


def test_a_moebius_strip_becomes_a_shell() -> None:
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    w = np.array([-0.3, 0.3])
    x = (1 + w * np.cos(t / 2)[:, None]) * np.cos(t)[:, None]
    y = (1 + w * np.cos(t / 2)[:, None]) * np.sin(t)[:, None]
    z = w * np.sin(t / 2)[:, None]
    vertices = np.stack([x, y, z], axis=2).reshape(-1, 3)
    faces = []
    for i in range(60):
        a, b, c, d = 2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 3
        if i == 59:
            c, d = 1, 0
        faces += [[a, b, c], [b, d, c]]
    strip = as_trimesh(vertices, np.array(faces))
    repaired = repair(strip)
    assert_proper(repaired)
    thickness = RepairConfig().shell * np.linalg.norm(np.ptp(vertices, axis=0))
    assert repaired.mesh.volume == pytest.approx(strip.area * thickness, rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_whatever_is_missing_the_result_is_a_solid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=16, minor_sections=10)
    keep = rng.random(len(torus.faces)) < rng.uniform(0.1, 0.95)
    faces = np.asarray(torus.faces)[keep]
    faces = np.where(rng.random(len(faces))[:, None] < 0.3, faces[:, ::-1], faces)
    assert_proper(repair(as_trimesh(torus.vertices, faces)))


def test_repair_does_not_depend_on_place_turn_or_unit() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    bowl = as_trimesh(ball.vertices, np.asarray(ball.faces)[ball.triangles_center[:, 2] < 0.2])
    reference = repair(bowl).mesh.volume
    moved = bowl.copy()
    moved.apply_scale(1000.0)
    moved.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0], [7, 8, 9]))
    moved.apply_translation([5e3, -2e4, 1e4])
    assert repair(moved).mesh.volume == pytest.approx(1e9 * reference, rel=1e-3)


def test_too_many_triangles_are_simplified_within_the_bound() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    repaired = repair(ball, RepairConfig(max_faces=3000))
    assert_proper(repaired)
    assert len(repaired.mesh.faces) <= 3000
    (step,) = repaired.steps
    assert step.name == "simplify"
    bound = RepairConfig().max_deviation * np.linalg.norm(ball.extents)
    assert 0 < step.detail["deviation"] <= bound
    radii = np.linalg.norm(repaired.mesh.triangles_center, axis=1)
    assert radii.min() > 1 - bound - 1e-3  # of the dense ball: 1 - 6e-4


def test_nothing_left_is_refused() -> None:
    mesh = as_trimesh(np.zeros((4, 3)), np.array([[0, 1, 2]] * 4))
    with pytest.raises(MeshError):
        repair(mesh)


def holed_ball(*, around: int, along: int, cap: float) -> trimesh.Trimesh:
    """A unit ball of `around` meridians without the cap within `cap` rad of its pole."""
    polar = np.linspace(cap, np.pi, along)
    profile = np.stack([np.sin(polar), np.cos(polar)], axis=1)
    profile[-1, 0] = 0.0
    return trimesh.creation.revolve(profile, sections=around)


@pytest.mark.parametrize(("around", "along"), [(200, 12), (320, 20)])
def test_a_small_hole_is_filled_however_many_edges_it_has(around: int, along: int) -> None:
    repaired = repair(holed_ball(around=around, along=along, cap=0.3))
    assert_proper(repaired)
    assert "fill holes" in steps(repaired)
    assert repaired.mesh.volume == pytest.approx(4 / 3 * np.pi, rel=0.03)


def test_a_wide_opening_of_many_edges_stays_open() -> None:
    repaired = repair(holed_ball(around=200, along=12, cap=0.7))
    assert_proper(repaired)
    assert "fill holes" not in steps(repaired)
    assert repaired.mesh.volume < 0.3 * 4 / 3 * np.pi
