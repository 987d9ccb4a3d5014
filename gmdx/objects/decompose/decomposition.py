"""Convex hulls that stand for a closed surface in physics, as few as fidelity allows.

Three steps. One hull, if that is already close enough. Otherwise CoACD splits the surface
into more parts than needed, every one of them nearly convex; then parts are merged, the
pair that adds the least volume first, for as long as the union of what is left, simplified
to few vertices, stays within bounds of the surface. The number of merges is found by
bisection on the measured fidelity, so the judge is the surface itself, not CoACD's metric.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import manifold3d
import numpy as np
import trimesh

from gmdx.arrays import Array, Float, Int
from gmdx.errors import DecompositionError
from gmdx.objects.decompose.coacd_process import CoacdConfig, CoacdFailure, run_coacd
from gmdx.objects.decompose.fidelity import Distances, Fidelity, FidelityConfig, measure_fidelity
from gmdx.objects.decompose.hulls import (
    HullNode,
    grow_hull,
    hull_node,
    merge_sequence,
    simplify_hull,
    trim_hulls,
)
from gmdx.objects.manifold import from_manifold, to_manifold
from gmdx.objects.surface import SurfaceIndex

_log = logging.getLogger("gmdx")


@dataclass(frozen=True)
class Attempt:
    """One run of CoACD; finer ones follow where a coarser one is not close enough."""

    threshold: float  # m, concavity that CoACD leaves in a part
    seconds: float  # s of CPU time


@dataclass(frozen=True)
class DecomposeConfig:
    """Bounds on fidelity and on size, and how CoACD is run."""

    fidelity: FidelityConfig = field(default_factory=FidelityConfig)
    coacd: CoacdConfig = field(default_factory=CoacdConfig)
    attempts: tuple[Attempt, ...] = (  # in turn, until one is close enough
        Attempt(1.5e-3, 25.0),
        Attempt(1.0e-3, 25.0),
    )
    rescue: Attempt = Attempt(4e-3, 15.0)  # coarser, where an attempt failed
    simple_parts: int = 10  # where CoACD finds at most so many, it searches again with care
    careful: CoacdConfig = field(
        default_factory=lambda: CoacdConfig(mcts_nodes=20, mcts_iterations=60, mcts_max_depth=3)
    )
    max_hulls: int = 96  # of an object, at most
    max_vertices: int = 128  # of one hull
    vertex_tolerance: float = 2e-4  # m, by which a vertex left out of a hull may stick out
    overlap: float = 2e-5  # m, growth of each of several hulls, so that no slit is left between
    max_trim: float = 1.5e-4  # m, by which a solid's outer facets may be moved in for its volume
    min_thickness: float = 1e-5  # m, thinner parts are dropped
    headroom: float = 0.95  # share of the bounds that the search uses
    max_faces: int = 3000  # above this many triangles CoACD sees a simplified copy
    simplify_tolerances: tuple[float, ...] = (1e-4, 2e-4, 3e-4)  # m, tried in turn
    shell_thickness: float = 2.5e-3  # m, a shell's mean thickness (2 V / A) is at most this
    shell_fill: float = 0.35  # and it fills at most this share of its convex hull


@dataclass(frozen=True)
class Decomposition:
    """Convex hulls for physics, and what is known about them."""

    hulls: tuple[Float[Array, "_ 3"], ...]  # m, the vertices of each
    report: dict[str, Any]  # JSON


@dataclass(frozen=True)
class _Candidate:
    method: str
    hulls: tuple[Float[Array, "_ 3"], ...]
    fidelity: Fidelity
    strain: float  # the worst of the measures, each as a share of its bound
    trim: float = 0.0  # m, by which outer facets were moved in

    def distance_strain(self, bounds: FidelityConfig) -> float:
        """The worse of the two distances as a share of its bound."""
        return max(self.fidelity.to_surface.p95, self.fidelity.from_surface.p95) / bounds.distance

    def excess(self, headroom: float) -> float:
        """By how much the strain is above the headroom; 0 where the search is content."""
        return max(0.0, self.strain - headroom)


def decompose(
    mesh: trimesh.Trimesh, *, config: DecomposeConfig = DecomposeConfig()
) -> Decomposition:
    """Convex hulls whose union is within bounds of a closed surface, as few as possible.

    Solids are held to distance and volume, thin shells to distance alone: where walls are
    about as thin as the distance bound, volume says nothing.

    Args:
        mesh: A watertight, outward surface at its final scale, m.
        config: Bounds, sizes and search effort.

    Returns:
        The hulls and a JSON-able report. Everything but its "seconds" depends on the mesh and
        the configuration alone. Where no attempt was within bounds, the closest one is
        returned and the report says by how much it misses; where CoACD failed altogether,
        the convex hull, named as the fallback.

    Raises:
        DecompositionError: the mesh is flat, empty or inside out.
    """
    started = time.perf_counter()
    task = _Task(mesh, config)
    attempts: list[dict[str, Any]] = []
    best = task.single()
    for attempt in config.attempts:
        if best.excess(config.headroom) == 0:
            break
        found, parts = task.attempt(attempt, config.coacd, attempts)
        best = min([best, *found], key=task.rank)
        if 0 < parts <= config.simple_parts:
            found, _ = task.attempt(attempt, config.careful, attempts)
            best = min([best, *found], key=task.rank)
        if parts == 0:  # no finer attempt will do better
            found, _ = task.attempt(config.rescue, config.coacd, attempts)
            best = min([best, *found], key=task.rank)
            break
        if parts > 3 * config.max_hulls:
            break  # the limit on hulls is what keeps it out of bounds, not CoACD's threshold
    failed = bool(attempts) and all("failure" in a for a in attempts)
    if failed:
        _log.warning("every attempt of CoACD failed; the convex hull stands in")
    report = task.report(best)
    report |= {
        "attempts": attempts,
        "fallback": "convex hull" if failed else None,
        "seconds": time.perf_counter() - started,
    }
    return Decomposition(best.hulls, report)


class _Task:
    """One mesh and the means to judge hulls against it."""

    def __init__(self, mesh: trimesh.Trimesh, config: DecomposeConfig) -> None:
        self.config = config
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
        hull = hull_node(vertices) if np.isfinite(vertices).all() else None
        a, b, c = vertices[faces].reshape(-1, 3, 3).transpose(1, 0, 2)
        self.volume = float((np.cross(a, b) * c).sum() / 6)
        if hull is None or self.volume <= 0:
            raise DecompositionError(
                f"the mesh ({len(faces)} triangles) encloses no volume ({self.volume:g} m^3); "
                "repair it to a closed surface that faces outward"
            )
        self.hull = hull
        self.area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
        self.thickness = 2 * self.volume / self.area
        self.fill = self.volume / hull.volume
        self.shell = self.thickness <= config.shell_thickness and self.fill <= config.shell_fill
        fidelity = config.fidelity
        self.surface = SurfaceIndex(vertices, faces, n=fidelity.samples, seed=fidelity.seed)
        self.coarse_vertices, self.coarse_faces, self.deviation = self._coarse(vertices, faces)

    def _coarse(
        self, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]
    ) -> tuple[Float[Array, "w 3"], Int[Array, "g 3"], float]:
        """A copy with fewer triangles for CoACD, and its largest measured deviation, m."""
        if len(faces) <= self.config.max_faces:
            return vertices, faces, 0.0
        solid = to_manifold(vertices, faces)
        if solid.status() != manifold3d.Error.NoError:
            _log.warning("not simplified for CoACD: %s", solid.status())
            return vertices, faces, 0.0
        for tolerance in self.config.simplify_tolerances:
            coarse_vertices, coarse_faces = from_manifold(solid.simplify(tolerance))
            if len(coarse_faces) <= self.config.max_faces:
                break
        fidelity = self.config.fidelity
        index = SurfaceIndex(coarse_vertices, coarse_faces, n=fidelity.samples, seed=fidelity.seed)
        deviation = max(
            self.surface.distance(index.samples).max(), index.distance(self.surface.samples).max()
        )
        return coarse_vertices, coarse_faces, float(deviation)

    def rank(self, candidate: _Candidate) -> tuple[float, int, float]:
        """What is best comes first: within bounds, then few hulls, then close."""
        hulls = len(candidate.hulls)
        return (candidate.excess(self.config.headroom), hulls, candidate.strain)

    def attempt(
        self, attempt: Attempt, coacd: CoacdConfig, record: list[dict[str, Any]]
    ) -> tuple[list[_Candidate], int]:
        """Split and merge: the candidate if there is one, and how many parts CoACD made."""
        name = f"coacd {attempt.threshold * 1e3:g} mm"
        entry: dict[str, Any] = {
            "threshold_mm": _round(attempt.threshold * 1e3),
            "mcts_max_depth": coacd.mcts_max_depth,
        }
        record.append(entry)
        try:
            parts = run_coacd(
                self.coarse_vertices,
                self.coarse_faces,
                threshold=attempt.threshold,
                seconds=attempt.seconds,
                config=coacd,
            )
        except CoacdFailure as failure:
            _log.warning("%s: %s", name, failure)
            entry["failure"] = str(failure)
            return [], 0
        nodes = [hull_node(part, thickness=self.config.min_thickness) for part in parts]
        kept = tuple(node for node in nodes if node is not None)
        entry |= {"parts": len(parts), "parts_dropped": len(parts) - len(kept)}
        if not kept:
            return [], len(parts)
        found = self.merged(kept, name)
        entry |= {"hulls": len(found.hulls), "strain": _round(found.strain)}
        return [found], len(parts)

    def single(self) -> _Candidate:
        """The convex hull alone."""
        return self._trimmed(self._judge("convex hull", [self._simple(self.hull)]))

    def merged(self, parts: tuple[HullNode, ...], method: str) -> _Candidate:
        """The fewest hulls within bounds, or the closest that the hull limit allows."""
        sequence = merge_sequence(parts, gap=self.config.fidelity.distance)
        ready: dict[int, Float[Array, "_ 3"]] = {}

        def judge(merges: int) -> _Candidate:
            for i in sequence.after(merges):
                if i not in ready:
                    ready[i] = grow_hull(self._simple(sequence.nodes[i]), self.config.overlap)
            return self._trimmed(self._judge(method, [ready[i] for i in sequence.after(merges)]))

        def content(candidate: _Candidate) -> bool:
            return candidate.excess(self.config.headroom) == 0

        low = min(max(0, len(parts) - self.config.max_hulls), len(sequence.pairs))
        high = len(sequence.pairs)
        best = judge(low)
        while content(best) and low < high:
            middle = (low + high + 1) // 2
            candidate = judge(middle)
            if content(candidate):
                low, best = middle, candidate
            else:
                high = middle - 1
        return best

    def _trimmed(self, candidate: _Candidate) -> _Candidate:
        """The same with outer facets moved in, where only that brings the volume in bounds.

        Hulls fill concavities, so their union is too large even where the surface is near.
        """
        ratio, bounds = candidate.fidelity.volume_ratio, self.config.fidelity
        over = ratio - 1 - self.config.headroom * bounds.volume
        if self.shell or over <= 0 or candidate.distance_strain(bounds) > self.config.headroom:
            return candidate
        depth = (over + 0.1 * bounds.volume) * self.volume / self.area
        if depth > self.config.max_trim:
            return candidate
        hulls = trim_hulls(candidate.hulls, depth, probe=self.config.overlap)
        if any(hull_node(h, thickness=self.config.min_thickness) is None for h in hulls):
            return candidate
        trimmed = replace(self._judge(candidate.method, hulls), trim=depth)
        return min(candidate, trimmed, key=lambda c: c.strain)

    def _simple(self, node: HullNode) -> Float[Array, "_ 3"]:
        return simplify_hull(
            node,
            tolerance=self.config.vertex_tolerance,
            max_vertices=self.config.max_vertices,
        )

    def _judge(self, method: str, hulls: Sequence[Float[Array, "_ 3"]]) -> _Candidate:
        bounds = self.config.fidelity
        fidelity = measure_fidelity(hulls, self.surface, self.volume, config=bounds)
        strain = abs(fidelity.volume_ratio - 1) / bounds.volume
        candidate = _Candidate(method, tuple(hulls), fidelity, strain)
        distance = candidate.distance_strain(bounds)
        return replace(candidate, strain=distance if self.shell else max(strain, distance))

    def report(self, best: _Candidate) -> dict[str, Any]:
        """What was made and how close it is, JSON-able."""
        bounds, fidelity = self.config.fidelity, best.fidelity
        return {
            "method": best.method,
            "kind": "shell" if self.shell else "solid",
            "mean_thickness_mm": _round(self.thickness * 1e3),
            "hull_fill": _round(self.fill),
            "hulls": len(best.hulls),
            "vertices": sum(len(h) for h in best.hulls),
            "max_vertices": max(len(h) for h in best.hulls),
            "volume_ratio": _round(fidelity.volume_ratio),
            "hulls_to_surface_mm": _millimetres(fidelity.to_surface),
            "surface_to_hulls_mm": _millimetres(fidelity.from_surface),
            "bounds": {
                "p95_mm": _round(bounds.distance * 1e3),
                "volume": None if self.shell else bounds.volume,
            },
            "within_bounds": best.strain <= 1,
            "miss": _round(max(0.0, best.strain - 1)),  # share of the bound that is missed most
            "trim_mm": _round(best.trim * 1e3),
            "simplified_faces": len(self.coarse_faces),
            "simplified_deviation_mm": _round(self.deviation * 1e3),
        }


def _millimetres(distances: Distances) -> dict[str, float]:
    return {name: _round(metres * 1e3) for name, metres in asdict(distances).items()}


def _round(value: float) -> float:
    return float(f"{value:.6g}")
