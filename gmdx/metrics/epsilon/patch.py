"""Which contacts of a pad matter to a grasp's quality: an exact reduction."""

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.grasps.grasp import PadContacts

_ALIKE = 6  # decimals to which normals, and offsets in m, are the same


def essential_contacts(contacts: PadContacts) -> PadContacts:
    """The contacts without those that lie inside a flat patch, in fewer slots.

    Where normals are equal, a contact's set of wrenches is linear in its position, so one that
    lies within the convex hull of others adds nothing to the convex hull of all wrenches: of a
    flat patch only the corners count, and the epsilon quality stays what it was.

    Args:
        contacts: Of n grasps, with k slots a pad.

    Returns:
        The corners, in as many slots a pad as the grasp with the most corners needs (at least 1).
    """
    keep = np.zeros_like(contacts.valid)
    for grasp, pad in np.argwhere(contacts.valid.any(axis=2)):
        slots = np.flatnonzero(contacts.valid[grasp, pad])
        corners = _corners(contacts.points[grasp, pad, slots], contacts.normals[grasp, pad, slots])
        keep[grasp, pad, slots[corners]] = True
    return _compacted(contacts, keep)


def _compacted(contacts: PadContacts, keep: Bool[Array, "n 2 k"]) -> PadContacts:
    slots = max(int(keep.sum(axis=2).max(initial=1)), 1)
    order = np.argsort(~keep, axis=2, kind="stable")[:, :, :slots]
    valid = np.take_along_axis(keep, order, axis=2)
    points = np.take_along_axis(contacts.points, order[..., None], axis=2)
    normals = np.take_along_axis(contacts.normals, order[..., None], axis=2)
    return PadContacts(
        np.where(valid[..., None], points, np.nan),
        np.where(valid[..., None], normals, np.nan),
        valid,
    )


def _corners(points: Float[Array, "m 3"], normals: Float[Array, "m 3"]) -> list[int]:
    """Indices of the corners of every flat patch: points of one plane with one normal."""
    patches: dict[tuple[float, ...], list[int]] = {}
    offset = (points * normals).sum(axis=1)
    # Adding 0.0 makes -0.0 the same key as 0.0.
    keys = np.round(np.column_stack([normals, offset]), _ALIKE) + 0.0
    for i, key in enumerate(map(tuple, keys)):
        patches.setdefault(key, []).append(i)
    corners = []
    for patch in patches.values():
        flat = points[patch] @ _plane(normals[patch[0]]).T
        corners += [patch[i] for i in hull_corners(flat)]
    return sorted(corners)


def _plane(normal: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two unit vectors across a normal."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def hull_corners(points: Float[Array, "m 2"]) -> list[int]:
    """Indices of the corners of the convex hull of points in a plane (Andrew 1979).

    Points that coincide or lie on an edge are left out, also when all lie on one line.
    """
    order = np.lexsort((points[:, 1], points[:, 0]))
    scale = float(np.ptp(points, axis=0).max(initial=0.0))
    if scale == 0.0:
        return [int(order[0])]
    xy = ((points - points.min(axis=0)) / scale).tolist()

    def half(indices: list[int]) -> list[int]:
        chain: list[int] = []
        for i in indices:
            while len(chain) > 1 and _turn(xy[chain[-2]], xy[chain[-1]], xy[i]) <= 1e-9:
                chain.pop()
            chain.append(i)
        return chain

    forward = [int(i) for i in order]
    lower, upper = half(forward), half(forward[::-1])
    return lower[:-1] + upper[:-1]


def _turn(a: list[float], b: list[float], c: list[float]) -> float:
    """Twice the signed area of a triangle: positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
