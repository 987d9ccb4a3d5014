"""Which side of a surface a point is on: orientation, and generalised winding numbers."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.objects.repair.read import neighbours

_CHUNK = 1_000_000  # solid angles computed at once, for bounded memory


def consistent_faces(faces: Int[Array, "f 3"]) -> tuple[Int[Array, "f 3"], Bool[Array, "f"]]:
    """Faces wound alike across every edge that two of them share, and which were turned.

    Each face stands twice in a graph, as it is and turned; edges join what agrees. Of the two
    mirror images of a connected surface, the one with its first face as it is, is taken. Where
    a surface is one-sided (a Moebius strip), no choice agrees everywhere and none is turned.
    """
    n = len(faces)
    pairs, agree = neighbours(faces)
    a, b = pairs.T
    other = np.where(agree, b, b + n)
    mirror = np.where(agree, b + n, b)
    rows, columns = np.concatenate([a, a + n]), np.concatenate([other, mirror])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    label = connected_components(graph, directed=False)[1]
    turned = label[:n] > label[n:]
    result = faces.copy()
    result[turned] = faces[turned][:, ::-1]
    return result, turned


def signed_volumes(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], label: Int[Array, "f"]
) -> Float[Array, "k"]:
    """Signed volume of each labelled closed part, by the divergence theorem."""
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    return np.bincount(label, (a * np.cross(b, c)).sum(axis=1) / 6.0)


def winding_number(
    points: Float[Array, "n 3"], triangles: Float[Array, "f 3 3"]
) -> Float[Array, "n"]:
    """How often a surface winds around each point: 0 outside a solid, 1 inside.

    The sum of the solid angles of all triangles over 4 pi (Van Oosterom and Strackee 1983;
    Jacobson et al. 2013).
    """
    result = np.empty(len(points))
    step = max(1, _CHUNK // max(1, len(triangles)))
    for start in range(0, len(points), step):
        p = points[start : start + step, None]
        a, b, c = (triangles[None, :, i] - p for i in range(3))
        la, lb, lc = (np.sqrt((v * v).sum(axis=2)) for v in (a, b, c))
        determinant = (a * np.cross(b, c)).sum(axis=2)
        divisor = (
            la * lb * lc
            + (a * b).sum(axis=2) * lc
            + (b * c).sum(axis=2) * la
            + (c * a).sum(axis=2) * lb
        )
        result[start : start + step] = np.arctan2(determinant, divisor).sum(axis=1) / (2 * np.pi)
    return result
