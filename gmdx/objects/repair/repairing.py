"""Make a closed, outward-facing surface of whatever triangles a file holds, and say how."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from gmdx.arrays import Array, Float
from gmdx.errors import MeshError
from gmdx.objects.manifold import from_manifold, to_manifold
from gmdx.objects.repair.holes import fill_holes
from gmdx.objects.repair.parts import nesting, worst_misfit
from gmdx.objects.repair.read import (
    as_trimesh,
    check_triangles,
    edge_counts,
    is_closed,
    is_consistent,
    merge_vertices,
    patches,
    used_vertices,
)
from gmdx.objects.repair.simplify import Simplified, simplify_closed, simplify_open
from gmdx.objects.repair.solid import misfit, thicken
from gmdx.objects.repair.winding import consistent_faces, signed_volumes


@dataclass(frozen=True)
class RepairConfig:
    """Bounds of the repairs. Lengths are shares of the mesh's bounding-box diagonal."""

    merge: float = 1e-6  # vertices as close as this are one
    hole_area: float = 0.04  # area of a hole / surface, above which it is a hollow object's opening
    shell: float = 0.01  # thickness given to surfaces that are open on both sides
    debris: float = 5e-4  # volume of a separate part / whole, below which it is dropped
    flap: float = 0.01  # area of a loose flap / whole, below which it is dropped
    misfit: float = 0.02  # share of the surface that may not part inside from outside
    max_faces: int = 20_000  # above this, the surface is simplified
    max_deviation: float = 1e-3  # bound on the move of the surface in that simplification
    max_open_faces: int = 6_000  # of a surface that is not closed, before it is made solid


@dataclass(frozen=True)
class RepairStep:
    """One change to the mesh, with its numbers."""

    name: str
    detail: dict[str, Any]


@dataclass(frozen=True)
class RepairedMesh:
    """A closed surface facing outward, and what was done to get it."""

    mesh: trimesh.Trimesh
    steps: tuple[RepairStep, ...]
    watertight_source: bool  # the source was closed once its vertices were merged
    source_volume: float | None  # enclosed by the source, if it was closed and wound alike
    misfit: float  # share of the surface that does not part inside from outside
    bodies: int  # separate closed parts


@dataclass
class _Work:
    """A mesh under repair."""

    vertices: Array
    faces: Array
    steps: list[RepairStep]

    def done(self, name: str, **detail: Any) -> None:
        self.steps.append(RepairStep(name, detail))

    def apply(self, name: str, simple: Simplified) -> None:
        """Take over a simplified surface."""
        detail: dict[str, Any] = {"before": len(self.faces), "after": len(simple.faces)}
        self.vertices, self.faces = simple.vertices, simple.faces
        detail |= {"method": simple.method, "deviation": simple.deviation}
        self.done(name, **detail, volume_ratio=simple.volume_ratio)


def repair(mesh: trimesh.Trimesh, config: RepairConfig | None = None) -> RepairedMesh:
    """Close a mesh: merge, clean, orient, fill small holes, and make solid what is still open.

    Raises:
        MeshError: No closed surface with a volume can be made of it.
    """
    config = RepairConfig() if config is None else config
    work = _Work(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64), [])
    check_triangles("mesh", work.vertices, work.faces)
    diagonal = _diagonal(work.vertices[used_vertices(work.faces)])
    _clean(work, tolerance=config.merge * diagonal)
    check_triangles("mesh after merging equal vertices", work.vertices, work.faces)
    _part_touching(work)
    watertight_source = is_closed(work.faces)
    source_volume = None
    if watertight_source and is_consistent(work.faces):
        source_volume = abs(_volume(work))
    if not watertight_source:
        _drop_flaps(work, share=config.flap)
    wrong = _close(work, config=config)
    if wrong is None and len(work.faces) > config.max_open_faces:
        simple = simplify_open(work.vertices, work.faces, max_faces=config.max_open_faces)
        work.apply("simplify open surface", simple)
        wrong = _close(work, config=config)  # holes have fewer edges now
    if wrong is None:
        _make_solid(work, thickness=config.shell * diagonal)
        wrong = misfit(work.vertices, work.faces)
    if len(work.faces) > config.max_faces:
        simple = simplify_closed(
            work.vertices,
            work.faces,
            max_faces=config.max_faces,
            bound=config.max_deviation * diagonal,
        )
        work.apply("simplify", simple)
    volume = _volume(work)
    if volume <= 1e-9 * diagonal**3:
        raise MeshError(
            f"the closed surface encloses no volume ({volume:.3g} for a diagonal of {diagonal:.3g})"
        )
    return RepairedMesh(
        mesh=as_trimesh(work.vertices, work.faces),
        steps=tuple(work.steps),
        watertight_source=watertight_source,
        source_volume=source_volume,
        misfit=wrong,
        bodies=int(patches(work.faces).max()) + 1,
    )


def _clean(work: _Work, *, tolerance: float) -> None:
    """Merge vertices; drop faces without area or that are there twice."""
    before = len(used_vertices(work.faces))
    work.vertices, work.faces = merge_vertices(work.vertices, work.faces, tolerance=tolerance)
    if len(work.vertices) != before:
        work.done("merge vertices", before=before, after=len(work.vertices))
    a, b, c = work.faces.T
    proper = (a != b) & (b != c) & (c != a)
    if not proper.all():
        work.faces = work.faces[proper]
        work.done("drop collapsed faces", faces=int((~proper).sum()))
    _, first, same, count = np.unique(
        np.sort(work.faces, axis=1), axis=0, return_index=True, return_inverse=True,
        return_counts=True,
    )  # fmt: skip
    if (count > 1).any():
        once = work.faces[np.sort(first)]
        single = work.faces[count[same.ravel()] == 1]  # a fold of no thickness vanishes whole
        kept = single if len(single) > 3 and is_closed(single) else once
        work.done("drop faces that are there twice", faces=len(work.faces) - len(kept))
        work.faces = kept


def _part_touching(work: _Work) -> None:
    """Give closed parts that touch along an edge vertices of their own."""
    label = patches(work.faces)
    key, corner = np.unique(work.faces + len(work.vertices) * label[:, None], return_inverse=True)
    faces = corner.reshape(-1, 3)
    if is_closed(faces) and not is_closed(work.faces):
        work.vertices, work.faces = work.vertices[key % len(work.vertices)], faces
        work.done("part what touches", parts=int(label.max()) + 1)


def _drop_flaps(work: _Work, *, share: float) -> None:
    """Drop small patches that hang loose: they end in the open, or on the rest at one edge."""
    label = patches(work.faces)
    loose = np.bincount(label, (edge_counts(work.faces) == 1).any(axis=1)) > 0
    area = as_trimesh(work.vertices, work.faces).area_faces
    drop = (loose & (np.bincount(label, area) < share * area.sum()))[label]
    if drop.any() and not drop.all():
        work.faces = work.faces[~drop]
        work.done(
            "drop loose flaps",
            faces=int(drop.sum()),
            area_share=float(area[drop].sum() / area.sum()),
        )


def _fill_holes(work: _Work, *, share: float) -> None:
    """Close what is missing of the surface, but not what is open by design."""
    faces, turned = consistent_faces(work.faces)
    area = float(as_trimesh(work.vertices, faces).area)
    filled = fill_holes(work.vertices, faces, area=share * area)
    if filled.holes == 0:
        return
    if turned.any():
        work.done("turn faces to agree", faces=int(turned.sum()))
    work.faces = filled.faces
    detail = {"holes": filled.holes, "widest": filled.widest, "area_share": filled.area / area}
    work.done("fill holes", **detail)


def _close(work: _Work, *, config: RepairConfig) -> float | None:
    """Fill what small holes there are, and make one solid of the closed parts.

    Returns the misfit of the outcome, or None if that gives no proper solid.
    """
    if not is_closed(work.faces):
        _fill_holes(work, share=config.hole_area)
    faces, turned = consistent_faces(work.faces)
    if turned.any() and is_closed(faces) and is_consistent(faces):
        work.faces = faces
        work.done("turn faces to agree", faces=int(turned.sum()))
    return _closed_parts(work, config=config)


def _closed_parts(work: _Work, *, config: RepairConfig) -> float | None:
    """Face closed parts outward and unite them.

    Returns the misfit of the outcome, or None if that gives no proper solid.
    """
    if not (is_closed(work.faces) and is_consistent(work.faces)):
        return None
    label = patches(work.faces)
    volumes = signed_volumes(work.vertices, work.faces, label)
    keep = np.abs(volumes) >= config.debris * np.abs(volumes).max()
    faces = work.faces[keep[label]]
    label = np.unique(label[keep[label]], return_inverse=True)[1]
    volumes = volumes[keep]
    signs, depths = nesting(work.vertices, faces, label, volumes)
    turned = (signs * volumes < 0)[label]
    faces[turned] = faces[turned][:, ::-1]
    vertices = work.vertices
    wrong = worst_misfit(vertices, faces, label)
    if wrong > config.misfit:
        work.done("found self-intersection", area_share=wrong)
        return None
    steps: list[RepairStep] = []
    if not keep.all():
        lost = float(np.abs(signed_volumes(vertices, work.faces, patches(work.faces)))[~keep].sum())
        share = lost / float(np.abs(volumes).sum())
        steps.append(
            RepairStep("drop debris", {"parts": int((~keep).sum()), "volume_share": share})
        )
    if turned.any():
        steps.append(RepairStep("turn inside-out parts", {"faces": int(turned.sum())}))
    if len(volumes) > 1:
        if to_manifold(vertices, faces).is_empty():
            return None
        order = np.argsort(-np.abs(volumes), kind="stable")
        solid = to_manifold(vertices, faces[label == order[0]])
        for part in order[1:]:
            piece = faces[label == part]
            if signs[part] > 0:
                solid = solid + to_manifold(vertices, piece)
            else:
                solid = solid - to_manifold(vertices, piece[:, ::-1])
        vertices, faces = from_manifold(solid)
        detail = {"parts": len(volumes), "voids": int((signs < 0).sum()),
                  "inside_others": int((depths > 0).sum())}  # fmt: skip
        steps.append(RepairStep("unite parts", detail))
    if len(faces) == 0:
        return None
    used = used_vertices(faces)
    work.vertices, work.faces = vertices[used], np.searchsorted(used, faces)
    work.steps.extend(steps)
    return wrong


def _volume(work: _Work) -> float:
    part = np.zeros(len(work.faces), int)
    return float(signed_volumes(work.vertices, work.faces, part)[0])


def _make_solid(work: _Work, *, thickness: float) -> None:
    """Replace a surface that is not closed by a solid."""
    area = as_trimesh(work.vertices, work.faces).area_faces
    kept = work.faces[area > 1e-10 * area.max()]
    open_edges = int((edge_counts(kept) == 1).sum())
    crowded_edges = int((edge_counts(kept) > 2).sum())
    solid = thicken(work.vertices, kept, thickness=thickness)
    work.vertices, work.faces = solid.vertices, solid.faces
    work.done(
        "make solid",
        open_edges=open_edges,
        edges_of_many_faces=crowded_edges,
        filled_spaces=solid.filled,
        shell_share=solid.sheet_share,
        shell_thickness=thickness,
    )


def _diagonal(points: Float[Array, "n 3"]) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))
