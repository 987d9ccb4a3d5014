"""The bundled objects: closed surfaces with the volumes, holes and sizes that geometry demands."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from gmdx_assets.make_objects import DIGITS, FOLDER, TOLERANCE, difference, main, read_obj
from gmdx_assets.parametric import SHAPES, Solid
from gmdx_assets.parametric.csg import combine
from gmdx_assets.parametric.solids import arc, bend, densify, extrude, revolve, sweep

NAMES = sorted(SHAPES)


def as_mesh(solid: Solid) -> trimesh.Trimesh:
    return trimesh.Trimesh(solid.vertices, solid.faces, process=False)


@pytest.fixture(scope="module")
def meshes() -> dict[str, trimesh.Trimesh]:
    return {name: as_mesh(read_obj(FOLDER / f"{name}.obj")) for name in NAMES}


def polygon_share(count: int) -> float:
    """Area of a regular polygon / area of the circle around it."""
    return count / (2 * np.pi) * np.sin(2 * np.pi / count)


def revolved_volume(profile: np.ndarray) -> float:
    """Of a full turn, by frustums: profile (m, 2) of radii and heights."""
    (r0, z0), (r1, z1) = profile[:-1].T, profile[1:].T
    return float(np.pi / 3 * ((z1 - z0) * (r0**2 + r0 * r1 + r1**2)).sum())


def hits(mesh: trimesh.Trimesh, x: float, y: float) -> np.ndarray:
    """Heights where the vertical line through (x, y) meets the surface, from the top down."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    (bx, by), (cx, cy) = (b - a)[:, :2].T, (c - a)[:, :2].T
    px, py = x - a[:, 0], y - a[:, 1]
    double = bx * cy - by * cx
    upright = np.abs(double) < 1e-15
    double = np.where(upright, 1.0, double)
    u, v = (px * cy - py * cx) / double, (bx * py - by * px) / double
    met = ~upright & (u >= 0) & (v >= 0) & (u + v <= 1)
    heights = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
    found: np.ndarray = np.sort(heights[met])[::-1]
    return found


def test_the_folder_holds_each_shape_and_stays_small() -> None:
    files = {path.stem: path for path in FOLDER.glob("*.obj")}
    assert sorted(files) == NAMES
    assert len(NAMES) >= 16
    sizes = [path.stat().st_size for path in files.values()]
    assert max(sizes) < 150_000
    assert sum(sizes) < 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_each_file_is_one_closed_outward_surface_of_good_triangles(
    name: str, meshes: dict[str, trimesh.Trimesh]
) -> None:
    mesh = meshes[name]
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert 500 <= len(mesh.faces) <= 3000
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    smallest = np.degrees(mesh.face_angles.min(axis=1))
    assert smallest.min() > 3
    assert np.percentile(smallest, 1) > 7


@pytest.mark.parametrize("name", NAMES)
def test_each_file_is_what_the_code_makes(name: str, meshes: dict[str, trimesh.Trimesh]) -> None:
    solid, stored = SHAPES[name](), meshes[name]
    made = as_mesh(solid)
    assert made.volume == pytest.approx(stored.volume, rel=1e-3)
    assert made.area == pytest.approx(stored.area, rel=1e-3)
    assert len(made.vertices) == len(stored.vertices)
    assert difference(solid, read_obj(FOLDER / f"{name}.obj")) < 1e-6


def test_the_command_writes_and_checks(tmp_path: Path) -> None:
    assert main(["--out", str(tmp_path)]) == 0
    assert main(["--check", "--out", str(tmp_path)]) == 0
    assert sorted(path.stem for path in tmp_path.iterdir()) == NAMES
    moved = tmp_path / "egg.obj"
    lines = moved.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("v "))
    lines[first] = f"v 0 0 {-10 * TOLERANCE:.{DIGITS}f}"
    moved.write_text("\n".join(lines) + "\n")
    assert main(["--check", "--out", str(tmp_path)]) == 1
    moved.unlink()
    assert main(["--check", "--out", str(tmp_path)]) == 1


def test_volumes_by_closed_form(meshes: dict[str, trimesh.Trimesh]) -> None:
    mm3 = {name: mesh.volume * 1e9 for name, mesh in meshes.items()}
    torus = 2 * np.pi**2 * 30 * 8**2
    assert mm3["ring"] == pytest.approx(torus * polygon_share(48) * polygon_share(16), rel=1e-4)
    assert mm3["ring"] == pytest.approx(torus, rel=0.03)
    chamfer = np.pi / 3 * 4 * (24**2 + 24 * 28 + 28**2)
    dumbbell = 2 * (np.pi * 28**2 * 32 + 2 * chamfer) + np.pi * 13**2 * 90
    assert mm3["dumbbell"] == pytest.approx(dumbbell * polygon_share(32), rel=1e-4)
    assert mm3["l_profile"] == pytest.approx((40**2 - 34**2) * 100, rel=1e-5)
    assert mm3["cross"] == pytest.approx((2 * 90 * 26 - 26**2) * 22, rel=1e-5)
    corners = 4 * 10**2 - np.pi * 10**2 * polygon_share(20)
    assert mm3["plate"] == pytest.approx((120 * 80 - corners) * 5, rel=1e-5)
    assert mm3["egg"] == pytest.approx(2 / 3 * np.pi * 22.5**2 * (25 + 33), rel=0.02)
    holes = 2 * np.pi * 5.5**2 * polygon_share(12)
    flat = (108 * 45 - (4 - np.pi) * 6**2 - holes) * 5
    assert mm3["bracket"] == pytest.approx(flat, rel=0.01)


def test_hollow_ones_hold_what_their_insides_measure(meshes: dict[str, trimesh.Trimesh]) -> None:
    cup = meshes["cup"].volume * 1e9
    outside = np.pi / 3 * 110 * (26**2 + 26 * 37.8 + 37.8**2)
    inside = np.pi / 3 * 106 * (23.5**2 + 23.5 * 35 + 35**2)
    assert cup == pytest.approx(outside - inside, rel=0.05)
    # The bowl lies between two half ellipsoids; its foot is a disc with a hollow, less the cap of
    # the outer ellipsoid that is inside the disc; its lip is a ring.
    bowl = meshes["bowl"].volume * 1e9
    wall = 2 / 3 * np.pi * (70**2 * 56 - 65**2 * 51)
    depth = 56 * (1 - np.cos(np.radians(28)))
    cap = np.pi * (70 / 56) ** 2 * depth**2 * (56 - depth / 3)
    foot = np.pi * (32**2 * (4 + depth) - 26.5**2 * 3) - cap
    lip = np.pi * (69.5**2 - 65.8**2) * 1.5
    assert bowl == pytest.approx(wall + foot + lip, rel=0.02)


@pytest.mark.parametrize(
    ("name", "bottom", "inside"),
    [("mug", 6e-3, 30e-3), ("bowl", 9e-3, 15e-3), ("cup", 4e-3, 20e-3)],
)
def test_a_line_down_the_axis_meets_the_inner_bottom(
    name: str, bottom: float, inside: float, meshes: dict[str, trimesh.Trimesh]
) -> None:
    mesh = meshes[name]
    for x, y in [(1e-4, 2e-4), (0.5 * inside, 1e-4), (1e-4, -0.9 * inside)]:
        heights = hits(mesh, x, y)
        assert len(heights) == 2
        assert heights[0] == pytest.approx(bottom, abs=2.5e-3)
    top = mesh.bounds[1, 2]
    assert hits(mesh, 1e-4, 2e-4)[0] < 0.2 * top


def test_a_solid_bottle_and_open_holes(meshes: dict[str, trimesh.Trimesh]) -> None:
    assert len(hits(meshes["bottle"], 1e-4, 2e-4)) == 2
    for name, x, y in [("ring", 0.0, 0.0), ("gear", 1e-4, 2e-4), ("spanner", 0.176, 1e-4)]:
        assert len(hits(meshes[name], x, y)) == 0
    assert len(hits(meshes["bracket"], -0.027, 1e-4)) == 0
    assert len(hits(meshes["bracket"], -0.015, 1e-4)) == 2


@pytest.mark.parametrize("name", NAMES)
def test_number_of_through_holes(name: str, meshes: dict[str, trimesh.Trimesh]) -> None:
    holes = {"ring": 1, "mug": 1, "gear": 1, "spanner": 1, "bracket": 2}.get(name, 0)
    assert meshes[name].euler_number == 2 - 2 * holes


@pytest.mark.parametrize(
    ("name", "sizes_mm"),
    [
        ("mug", (80, 95, 115)), ("bottle", (65, 65, 212)), ("bowl", (62, 140, 140)),
        ("hammer", (30, 112, 280)), ("spanner", (8, 36, 208)), ("bracket", (45, 55, 60)),
        ("gear", (14, 60, 60)), ("ring", (16, 76, 76)), ("dumbbell", (56, 56, 170)),
        ("cup", (76, 76, 110)), ("l_profile", (40, 40, 100)), ("cross", (22, 90, 90)),
        ("egg", (45, 45, 58)), ("plate", (5, 80, 120)), ("screw", (24, 28, 88)),
        ("spoon", (29, 42, 195)),
    ],
)  # fmt: skip
def test_sizes_are_those_of_the_real_thing(
    name: str, sizes_mm: tuple[int, int, int], meshes: dict[str, trimesh.Trimesh]
) -> None:
    assert np.sort(meshes[name].extents) * 1e3 == pytest.approx(sizes_mm, rel=0.03)


def test_the_thread_is_a_right_handed_helix_of_its_pitch(
    meshes: dict[str, trimesh.Trimesh],
) -> None:
    vertices = meshes["screw"].vertices
    thread = vertices[(vertices[:, 2] > -0.071) & (vertices[:, 2] < -0.031)]
    turn = 2 * np.pi / 12
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    advanced = thread[thread[:, 2] < -0.033] @ spin.T + [0, 0, 0.008 / 12]
    gaps = np.linalg.norm(advanced[:, None] - thread[None], axis=2).min(axis=1)
    assert gaps.max() < 3e-6
    radius = np.hypot(thread[:, 0], thread[:, 1])
    assert radius.min() == pytest.approx(0.006, abs=2e-6)
    assert radius.max() == pytest.approx(0.008, abs=2e-6)


def test_the_gear_repeats_with_its_teeth(meshes: dict[str, trimesh.Trimesh]) -> None:
    vertices = meshes["gear"].vertices
    rim = vertices[np.hypot(vertices[:, 0], vertices[:, 1]) > 0.0232]
    turn = 2 * np.pi / 18
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    gaps = np.linalg.norm((rim @ spin.T)[:, None] - rim[None], axis=2).min(axis=1)
    assert gaps.max() < 3e-6
    # A tooth is half a pitch wide on the pitch circle: between its flanks there, by interpolation.
    tooth = np.unique(
        np.round(rim[(np.abs(np.arctan2(rim[:, 1], rim[:, 0])) < turn / 2), :2], 6), axis=0
    )
    flank = tooth[tooth[:, 1] > 0]
    flank = flank[np.argsort(np.hypot(*flank.T))]
    half = np.interp(0.027, np.hypot(*flank.T), np.arctan2(flank[:, 1], flank[:, 0]))
    assert half == pytest.approx(turn / 4, rel=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_revolved_volume_follows_pappus(seed: int) -> None:
    """To the share of a circle that a polygon has; rings near a pole may have fewer sides."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.02, 0.05, 6)
    height = np.cumsum(rng.uniform(0.005, 0.02, 6))
    profile = np.column_stack([[0, *radius, 0], [height[0], *height, height[-1]]])
    mesh = as_mesh(revolve(densify(profile, 0.009), segments=40))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(revolved_volume(profile) * polygon_share(40), rel=0.01)


def test_extruding_keeps_area_and_bending_keeps_volume() -> None:
    square = np.array([(-2, -1), (3, -1), (3, 1), (-2, 1)]) * 0.02
    hole = arc((0.02, 0.0), 0.006, 0, -360, 25)[:-1]
    flat = extrude([square, hole], 0.004, step=0.003)
    expected = (0.1 * 0.04 - np.pi * 0.006**2 * polygon_share(24)) * 0.004
    assert as_mesh(flat).volume == pytest.approx(expected, rel=1e-9)
    bent = as_mesh(bend(flat.moved((0, 0, -0.002)), 0.02, np.pi / 2))
    assert bent.is_watertight
    assert bent.volume == pytest.approx(expected, rel=5e-3)


def test_uniting_and_subtracting_count_the_overlap_once() -> None:
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.02
    block = extrude([square], 0.04, step=0.01).moved((0, 0, -0.02))
    path = np.column_stack([np.linspace(-0.04, 0.04, 9), np.zeros(9)])
    rod = sweep(path, arc((0, 0), 0.008, 0, 360, 17)[:-1], 0.004)
    cross_section = np.pi * 0.008**2 * polygon_share(16)
    settings = {"shortest": 0.001, "tolerance": 1e-4}
    united = as_mesh(combine([block, rod], **settings))
    drilled = as_mesh(combine([block], [rod], **settings))
    assert united.volume == pytest.approx(0.04**3 + cross_section * 0.04, rel=5e-3)
    assert drilled.volume == pytest.approx(0.04**3 - cross_section * 0.04, rel=5e-3)
    assert united.is_watertight
    assert drilled.euler_number == 0


def test_an_outline_too_narrow_for_its_step_is_refused() -> None:
    square = np.array([(0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1)])
    slit = np.array([(0.01, 5e-4), (0.01, 1e-3), (0.02, 1e-3), (0.03, 1e-3), (0.03, 5e-4)])
    with pytest.raises(ValueError, match="does not follow its outline"):
        extrude([square, slit], 0.01, step=0.02)
