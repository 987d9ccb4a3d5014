"""Rotations and poses on arrays. Quaternions are wxyz and of unit length."""

import numpy as np

from gmdx.arrays import Array, Float


def quaternion_matrix(q: Float[Array, "*n 4"]) -> Float[Array, "*n 3 3"]:
    """Rotation matrices of unit quaternions (wxyz)."""
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_quaternion(R: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Unit quaternion (wxyz, w >= 0) of one rotation matrix.

    Taken from the largest eigenvector of Bar-Itzhack's symmetric matrix (2000), which is
    accurate at every angle.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(R, float)
    K = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    q: Array = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def quaternion_multiply(a: Float[Array, "*n 4"], b: Float[Array, "*#n 4"]) -> Float[Array, "*n 4"]:
    """Hamilton product: the rotation that does b first, then a."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, float), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, float), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quaternion_conjugate(q: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """The inverse rotation."""
    conjugate: Array = np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def rotation_angle(a: Float[Array, "*n 4"], b: Float[Array, "*n 4"]) -> Float[Array, "*n"]:
    """Angle of the rotation that takes a to b, rad, in [0, pi]."""
    d = quaternion_multiply(quaternion_conjugate(a), b)
    angle: Array = 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))
    return angle


def yaw_quaternion(angle: Float[Array, "*n"]) -> Float[Array, "*n 4"]:
    """Quaternions of rotations about z by `angle`, rad."""
    half = 0.5 * np.asarray(angle, float)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def random_quaternion(rng: np.random.Generator) -> Float[Array, "4"]:
    """One rotation, uniform over SO(3)."""
    q = rng.standard_normal(4)
    return np.divide(q, np.linalg.norm(q))


def axis_angle_between(a: Float[Array, "*n 3"], b: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Angle between undirected axes (of any length), rad, in [0, pi/2]."""
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    dot = np.sum(np.asarray(a) * np.asarray(b), axis=-1)
    angle: Array = np.arctan2(cross, np.abs(dot))
    return angle
