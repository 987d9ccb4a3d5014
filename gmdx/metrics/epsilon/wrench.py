"""Contact wrench cones: what forces and torques a soft-finger contact can exert."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.errors import MetricError

_UNIT = 1e-6  # tolerated deviation of a normal's length from 1


@dataclass(frozen=True)
class WrenchCones:
    """Unit-normal-force wrench sets of contacts: contact i exerts c_i + B_i s with |s| <= 1.

    A wrench is (force, torque / torque_scale), the torque about the grasp's origin, so all
    six coordinates have the unit of the normal force.
    """

    centers: Float[Array, "*n k 6"]  # c_i: the wrench of the normal force alone
    spreads: Float[Array, "*n k 3 6"]  # rows of B_i^T: two tangential forces, one torsion

    def __getitem__(self, index: Any) -> "WrenchCones":
        """The cones at `index` of the leading axes."""
        return WrenchCones(self.centers[index], self.spreads[index])

    @property
    def columns(self) -> Float[Array, "*n r 6"]:
        """All centres and spreads of a grasp: they span what its contacts can exert."""
        both = np.concatenate([self.centers[..., None, :], self.spreads], axis=-2)
        return both.reshape(*both.shape[:-3], -1, 6)


def wrench_cones(
    points: Float[Array, "*n k 3"],
    normals: Float[Array, "*n k 3"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
) -> WrenchCones:
    """Wrench sets of soft-finger contacts with an elliptic limit surface.

    A contact force (f_n, f_t, tau_n) obeys (|f_t| / friction)^2 + (tau_n / torsion)^2 <= f_n^2.

    Args:
        points: Contact points, m.
        normals: Unit normals into the object.
        friction: Coulomb's coefficient mu.
        torsion: gamma: torsional moment a unit of normal force resists, m.
        torque_scale: L: the length by which torques are divided, m.
        origin: Point about which torques are taken, m.
    """
    arm = (points - origin) / torque_scale
    t1, t2 = tangents(normals)
    tangential = [friction * _at(arm, t) for t in (t1, t2)]
    twist = np.concatenate([np.zeros_like(normals), normals], axis=-1) * (torsion / torque_scale)
    return WrenchCones(_at(arm, normals), np.stack([*tangential, twist], axis=-2))


@dataclass(frozen=True)
class PrincipalAxes:
    """Along which orthogonal directions a grasp's wrenches extend how far, the least first."""

    widths: Float[Array, "6"]  # root of the sum of squares; 0 where they have no extent
    axes: Float[Array, "6 6"]  # columns

    @property
    def rounding(self) -> Float[Array, "6 6"]:
        """Columns u_i = axis_i / width_i: by their products with wrenches, K is round."""
        columns: Array = self.axes / np.maximum(self.widths, 1e-12 * self.widths[-1])
        return columns


def principal_axes(cones: WrenchCones) -> PrincipalAxes:
    """Principal axes of the centres and spreads of one grasp's contacts."""
    rows = np.concatenate([cones.columns, np.zeros((2, 6))])  # at least six
    _, widths, axes = np.linalg.svd(rows, full_matrices=False)
    return PrincipalAxes(widths[::-1], axes[::-1].T)


def tangents(
    normals: Float[Array, "*n 3"],
) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two unit tangents t1, t2 of each normal n, with n = t1 x t2."""
    sign = np.where(normals[..., 2] >= 0, 1.0, -1.0)
    x, y, z = np.moveaxis(normals, -1, 0)
    a = -1.0 / (sign + z)  # Duff et al., "Building an orthonormal basis, revisited", 2017
    b = x * y * a
    t1 = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    t2 = np.stack([b, sign + y * y * a, -y], axis=-1)
    return t1, t2


def contact_supports(cones: WrenchCones, u: Float[Array, "*m 6"]) -> Float[Array, "*m k"]:
    """h_i(u) = c_i . u + |B_i^T u|: how far each contact's wrenches reach along u."""
    slip = u @ cones.spreads.reshape(-1, 6).T
    slip = slip.reshape(*u.shape[:-1], len(cones.centers), 3)
    supports: Array = u @ cones.centers.T + np.sqrt(np.einsum("...k,...k->...", slip, slip))
    return supports


def support(cones: WrenchCones, u: Float[Array, "*m 6"]) -> Float[Array, "*m"]:
    """h(u) = max_i h_i(u): support function of the grasp wrench space K."""
    return np.asarray(contact_supports(cones, u).max(axis=-1))


def pair_closure(
    points: Float[Array, "*n 2 3"], normals: Float[Array, "*n 2 3"], *, friction: float
) -> Bool[Array, "*n"]:
    """Whether the line between two contacts lies strictly inside both friction cones.

    If it does, soft contacts (torsion > 0) hold by force closure (Nguyen, "Constructing
    force-closure grasps", 1988). If not they seldom do: torsion about normals that are not
    parallel can balance forces off the line, where it is large for the contacts' distance.
    """
    line = points[..., 1, :] - points[..., 0, :]
    length = np.linalg.norm(line, axis=-1)
    cosine = np.sqrt(1.0 / (1.0 + friction**2))
    inside = [
        sign * np.einsum("...j,...j->...", line, normals[..., i, :]) > cosine * length
        for i, sign in ((0, 1.0), (1, -1.0))
    ]
    return np.asarray(inside[0] & inside[1] & (friction > 0))


def check_contacts(
    points: Float[Array, "..."],
    normals: Float[Array, "..."],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "..."],
) -> None:
    """Refuse contacts and parameters for which no wrench space is defined.

    Raises:
        MetricError: Naming the argument that is wrong.
    """
    for name, value in (("points", points), ("normals", normals)):
        if value.ndim < 2 or value.shape[-1] != 3:
            raise MetricError(f"{name} must have shape (k, 3), not {value.shape}")
        if not np.isfinite(value).all():
            raise MetricError(f"{name} holds NaN or infinite values: leave invalid contacts out")
    if points.shape != normals.shape:
        raise MetricError(
            f"points {points.shape} and normals {normals.shape} must have the same shape"
        )
    if points.shape[-2] == 0:
        raise MetricError("points is empty: a grasp needs at least one contact")
    length = np.linalg.norm(normals, axis=-1)
    if (np.abs(length - 1.0) > _UNIT).any():
        raise MetricError(
            f"normals must be of unit length, not {length.flat[np.abs(length - 1.0).argmax()]:.6g}:"
            " divide each by its norm, and leave out contacts without one"
        )
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise MetricError(f"origin must be three finite coordinates, not {origin}")
    for name, scalar in (("friction", friction), ("torsion", torsion)):
        if not (np.isfinite(scalar) and scalar >= 0):
            raise MetricError(f"{name} must be a finite number >= 0, not {scalar}")
    if not (np.isfinite(torque_scale) and torque_scale > 0):
        raise MetricError(f"torque_scale must be a finite length > 0 m, not {torque_scale}")


def _at(arm: Float[Array, "*n 3"], force: Float[Array, "*n 3"]) -> Float[Array, "*n 6"]:
    """The wrench of a force that acts at the end of `arm`."""
    return np.concatenate([force, np.cross(arm, force)], axis=-1)
