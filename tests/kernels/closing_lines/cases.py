"""Surfaces and lines to find first touches on, all of them seeded."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from gmdx_kernels.closing_lines import FirstTouch, closing_lines, pad_grid

Array = np.ndarray[Any, np.dtype[Any]]
Number = int | float


@dataclass(frozen=True)
class Case:
    """Arguments of `closing_lines`."""

    vertices: Array
    faces: Array
    center: Array
    axis: Array
    up: Array
    width: Array
    offsets: Array

    def run(self, some: slice | Array = slice(None)) -> FirstTouch:
        """First touches of all grasps, or of some."""
        return closing_lines(
            self.vertices,
            self.faces,
            self.center[some],
            self.axis[some],
            self.up[some],
            self.width[some],
            offsets=self.offsets,
        )


def along_x(
    mesh: trimesh.Trimesh, center: list[list[Number]], width: list[float], offsets: Array
) -> Case:
    """Grasps that close along x and come from above, in the mesh's frame."""
    n = len(center)
    return Case(
        np.array(mesh.vertices),
        np.array(mesh.faces),
        np.array(center, dtype=float).reshape(n, 3),
        np.tile([1.0, 0.0, 0.0], (n, 1)),
        np.tile([0.0, 0.0, 1.0], (n, 1)),
        np.array(width, dtype=float),
        offsets,
    )


def random_grasps(
    mesh: trimesh.Trimesh, n: int, *, seed: int, level: bool = True, grid: tuple[int, int] = (4, 3)
) -> Case:
    """Grasps all over the mesh's box, half of their fingers beside it; closing level or anyhow."""
    rng = np.random.default_rng(seed)
    vertices = np.array(mesh.vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float((high - low).max())
    angle = rng.uniform(0, np.pi, n)
    frame = np.zeros((n, 3, 3))
    frame[:, 0, :2] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    frame[:, 2, 2] = 1.0
    if not level:
        frame = frame @ np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    return Case(
        vertices,
        np.array(mesh.faces),
        low + rng.uniform(0.05, 0.95, (n, 3)) * (high - low),
        frame[:, 0],
        frame[:, 2],
        size * rng.uniform(0.2, 1.6, n),
        pad_grid(np.array([0.3, 0.2]) * size, grid),
    )


def torus() -> Case:
    """A ring, which lines cross up to four times."""
    return random_grasps(trimesh.creation.torus(major_radius=0.03, minor_radius=0.01), 40, seed=1)


def tube() -> Case:
    """A wall with sharp rims, and long thin triangles."""
    return random_grasps(trimesh.creation.annulus(0.02, 0.025, height=0.06), 40, seed=2)


def knot() -> Case:
    """A star that lines cross many times, closed upon from everywhere."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    rng = np.random.default_rng(0)
    mesh.vertices *= 1 + 0.2 * rng.standard_normal((len(mesh.vertices), 1))
    return random_grasps(mesh, 40, seed=3, level=False)


def foil() -> Case:
    """A plate a tenth of a millimetre thick."""
    return random_grasps(trimesh.creation.box((0.06, 0.05, 1e-4)), 40, seed=4, level=False)


def film() -> Case:
    """A plate of a tenth of a micrometre."""
    return random_grasps(trimesh.creation.box((0.06, 0.05, 1e-7)), 40, seed=5, level=False)


def far_away() -> Case:
    """A small ball 20 m from the origin, where single precision resolves a micrometre."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    mesh.apply_translation([20.0, -20.0, 5.0])
    return random_grasps(mesh, 20, seed=6)


def soup() -> Case:
    """Triangles that intersect each other and close nothing."""
    rng = np.random.default_rng(7)
    corners = rng.uniform(-0.03, 0.03, (300, 1, 3)) + rng.uniform(-0.02, 0.02, (300, 3, 3))
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3), process=False)
    return random_grasps(mesh, 40, seed=8, level=False)


TWINNED: dict[str, Callable[[], Case]] = {
    case.__name__: case for case in (torus, tube, knot, foil, film, far_away, soup)
}


def ball_targets() -> Array:
    """All vertices and middles of edges of a ball of 30 mm but for those near its rim along x."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    middles = mesh.vertices[mesh.edges_unique].mean(axis=1)
    targets = np.concatenate([mesh.vertices, middles])
    return np.asarray(targets[np.hypot(targets[:, 1], targets[:, 2]) < 0.028])


def ball_corners() -> Case:
    """Lines along x through the ball's vertices and middles of edges."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    return along_x(mesh, [[0, 0, 0]], [0.1], np.ascontiguousarray(ball_targets()[:, 1:]))


def ball_rim() -> Case:
    """Lines that graze a ball at its outermost vertices and edges, turned at random."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    case = random_grasps(mesh, 24, seed=9, level=False)
    across = np.cross(case.up, case.axis)
    rim = (across @ mesh.vertices.T).argmax(axis=1)
    outermost = np.array(mesh.vertices)[rim]
    return replace(
        case,
        center=outermost - 0.01 * across,
        width=np.full(24, 0.2),
        offsets=np.array([[0.01, 0.0], [0.01 - 1e-6, 0.0], [0.01 + 1e-6, 0.0]]),
    )


def box_faces() -> Case:
    """Lines through diagonals, in the planes of a box's sides, along its edges, and beside it."""
    offsets = np.array([[0, 0], [0.01, 0.01 / 3], [-0.015, -0.005], [0.03, 0], [0.03, 0.01],
                        [0.02, 0.01], [0.031, 0], [-0.03, -0.01], [0.03, -0.01]])  # fmt: skip
    box = trimesh.creation.box((0.04, 0.06, 0.02))
    return along_x(box, [[0.005, 0, 0], [0, 0, 0], [-0.01, 0, 0]], [0.08, 0.04, 0.03], offsets)


def turned_box_faces() -> Case:
    """Lines in the planes of a turned box's sides and through its edges, but for rounding."""
    case = box_faces()
    turn = np.linalg.qr(np.random.default_rng(10).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned = {k: getattr(case, k) @ turn for k in ("vertices", "center", "axis", "up")}
    return replace(case, **turned)


def stack() -> Case:
    """Two boxes face to face: fingers inside one leave it where they enter the other."""
    left, right = (trimesh.creation.box((0.02, 0.04, 0.04)) for _ in range(2))
    left.apply_translation([-0.01, 0, 0])
    right.apply_translation([0.01, 0, 0])
    offsets = np.array([[0.0, 0.0], [0.001, 0.002], [-0.013, 0.017], [0.02, 0.0]])
    centers: list[list[Number]] = [[0, 0, 0], [0.005, 0, 0], [0.03, 0, 0], [0, 0, 0]]
    both = trimesh.util.concatenate([left, right])
    return along_x(both, centers, [0.02, 0.04, 0.05, 0.08], offsets)


def double() -> Case:
    """A ball whose every triangle is there twice."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    mesh = trimesh.Trimesh(ball.vertices, np.concatenate([ball.faces[::-1], ball.faces]))
    return random_grasps(mesh, 20, seed=11)


def needle() -> Case:
    """Lines through the tip of a needle, and within a hair's breadth of it."""
    mesh = trimesh.creation.cone(radius=0.002, height=0.06, sections=8)
    offsets = np.array([[0, 0], [0, 1e-6], [0, -1e-6], [0, -1e-4], [1e-6, -1e-4]])
    return along_x(mesh, [[0, 0, 0.06], [0.001, 0, 0.06]], [0.05, 0.05], offsets)


def tip() -> Case:
    """Level lines exactly through the tip of an upright, slender cone."""
    mesh = trimesh.creation.cone(radius=0.005, height=0.06, sections=12)
    case = random_grasps(mesh, 40, seed=15)
    apex = np.array(mesh.vertices)[mesh.vertices[:, 2].argmax()]
    return replace(
        case, center=np.tile(apex, (40, 1)), width=np.full(40, 0.2), offsets=np.zeros((1, 2))
    )


def fingers_inside() -> Case:
    """Both fingers in the solid, finger 0 in and finger 1 outside, and no solid between them."""
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    width = [0.03, 0.05, 0.05]
    return along_x(box, [[0, 0, 0], [0.015, 0, 0], [0.1, 0, 0]], width, np.array([[0.001, 0.002]]))


def at_the_fingers() -> Case:
    """A box between fingers that stand at its faces, but for rounding, or a hair off."""
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    room = [0.0, 1e-10, -1e-10, 1e-7, -1e-7, 1e-5, -1e-5]
    width = [0.04 + 2 * gap for gap in room]
    return along_x(box, [[0, 0, 0]] * 7, width, np.array([[0.001, 0.002], [-0.01, 0.013]]))


def bundled(name: str) -> trimesh.Trimesh:
    """A bundled object's mesh, in metres."""
    with as_file(files("gmdx_assets") / "objects" / f"{name}.obj") as path:
        return scan(path)


def scan(path: Path) -> trimesh.Trimesh:
    """A mesh file's content, scaled until its middle extent is 5 cm."""
    mesh = trimesh.load(path, force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.apply_scale(0.05 / np.sort(mesh.extents)[1])
    return mesh
