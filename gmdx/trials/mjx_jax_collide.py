"""Contacts of a world: the gripper's boxes with an object's hulls, and points with the table."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from gmdx.trials.mjx_jax_hulls import Hulls
from gmdx.trials.mjx_jax_manifold import APART, CONTACTS_A_PAIR, Manifold
from gmdx.trials.mjx_jax_narrow import box_hull, hull_in_box, turn

_TABLE_CONTACTS = 8  # of the gripper
_AROUND = 2 * np.pi * np.arange(_TABLE_CONTACTS - 1) / (_TABLE_CONTACTS - 1)


class Boxes(NamedTuple):
    """Boxes of the gripper in the world."""

    half: Any  # (b 3) m
    position: Any  # (b 3) m
    rotation: Any  # (b 3 3) axes as columns


def box_gaps(
    boxes: Boxes,
    hulls: Hulls,
    number: Array,
    place: Float[Array, "3"],
    axes: Float[Array, "3 3"],
) -> Float[Array, "b h"]:
    """Lower bounds of the distance of every box to every hull, m; +inf where a hull is not used.

    The hull's bounding box in the object's frame is parted from the box along the six face
    normals of both.
    """
    half, hull_half = boxes.half, hulls.half[number]
    center = place + turn(axes, hulls.center[number])
    offset = center[None] - boxes.position[:, None]
    along_box = jnp.abs(jnp.sum(offset[..., :, None] * boxes.rotation[:, None], axis=-2))
    along_hull = jnp.abs(jnp.sum(offset[..., :, None] * axes, axis=-2))
    shared = jnp.abs(
        jnp.sum(boxes.rotation[:, :, :, None] * axes[None, :, None, :], axis=1)
    )  # b i j
    reach_hull = jnp.sum(shared[:, None] * hull_half[None, :, None, :], axis=-1)
    reach_box = jnp.sum(shared * half[:, :, None], axis=1)
    gaps = jnp.maximum(
        jnp.max(along_box - half[:, None] - reach_hull, axis=-1),
        jnp.max(along_hull - hull_half[None] - reach_box[:, None], axis=-1),
    )
    return jnp.where(hulls.used[number][None], gaps, jnp.inf)


def pair_contacts(
    boxes: Boxes,
    hulls: Hulls,
    number: Array,
    place: Float[Array, "3"],
    axes: Float[Array, "3 3"],
    *,
    pairs: int,
) -> tuple[Manifold, Array, Array]:
    """Contacts of boxes with an object's hulls, computed for the `pairs` closest pairs only.

    Args:
        boxes: In the world.
        hulls: Of several objects.
        number: Which of them it is.
        place: m, of the object.
        axes: Of the object, as columns.
        pairs: How many may be close at once.

    Returns:
        Contacts (4 pairs), the box of each, and whether more pairs than that may touch.
    """
    gaps = box_gaps(boxes, hulls, number, place, axes)
    close, which = jax.lax.top_k(-gaps.ravel(), pairs)
    box, hull = which // gaps.shape[1], which % gaps.shape[1]

    def one(b: Array, h: Array) -> Manifold:
        position, rotation = boxes.position[b], boxes.rotation[b]
        local = hull_in_box(hulls, (number, h), place, axes, position, rotation)
        found = box_hull(boxes.half[b], local)
        return Manifold(
            found.distance,
            position + turn(rotation, found.position),
            turn(rotation, found.normal),
        )

    found = jax.vmap(one)(box, hull)
    distance = jnp.where(close[:, None] > 0, found.distance, APART)
    contacts = Manifold(
        distance.ravel(), found.position.reshape(-1, 3), found.normal.reshape(-1, 3)
    )
    return contacts, jnp.repeat(box, CONTACTS_A_PAIR), jnp.sum(gaps < 0) > pairs


def hull_table_contacts(
    hulls: Hulls, number: Array, place: Float[Array, "3"], axes: Float[Array, "3 3"]
) -> Manifold:
    """Four contacts at most of each hull with the table, chosen as C MuJoCo chooses them.

    They are the lowest vertex, and three more corners of the face at that vertex that looks down
    most, those above the mesh's own middle left out.
    """
    vertices, corner = hulls.vertices[number], hulls.corner[number]
    down = -axes[2]
    rows = jnp.arange(len(vertices))
    lowest = jnp.argmax(jnp.sum(vertices * down, axis=-1), axis=-1)  # (h)
    facing = jnp.sum(hulls.normals[number] * down, axis=-1)[rows[:, None], hulls.face[number]]
    face = jnp.argmax(jnp.where(corner == lowest[:, None], facing, -jnp.inf), axis=-1)
    others = hulls.support[number][rows, face]  # (h 3)
    chosen = jnp.concatenate([lowest[:, None], others], axis=1)
    points = place + turn(axes, jnp.take_along_axis(vertices, chosen[..., None], axis=1))
    middle = place + turn(axes, hulls.middle[number])
    again = jnp.any(jnp.tril(chosen[:, :, None] == chosen[:, None], k=-1), axis=2)
    counts = (jnp.arange(4) == 0) | (points[..., 2] <= middle[:, None, 2])
    there = hulls.used[number][:, None] & counts & ~again & (points[..., 2] < 0)
    return _on_table(points.reshape(-1, 3), there.ravel())


def table_contacts(points: Float[Array, "n 3"]) -> tuple[Manifold, Array]:
    """Of the gripper: the deepest of points below the table and the outermost in seven directions.

    A flat table feels no difference: what lies between them bears no other load.

    Returns:
        The contacts, and the index of each one's point.
    """
    below = points[:, 2] < 0
    reach = jnp.asarray(np.cos(_AROUND), points.dtype)[:, None] * points[:, 0]
    reach = reach + jnp.asarray(np.sin(_AROUND), points.dtype)[:, None] * points[:, 1]
    outer = jnp.argmax(jnp.where(below, reach, -jnp.inf), axis=1)
    chosen = jnp.concatenate([jnp.argmin(points[:, 2])[None], outer])
    again = jnp.any(jnp.tril(chosen[:, None] == chosen[None], k=-1), axis=1)
    return _on_table(points[chosen], ~again & below[chosen]), chosen


def _on_table(points: Array, there: Array) -> Manifold:
    distance = jnp.where(there, points[:, 2], APART)
    position = points.at[:, 2].multiply(0.5)
    up = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0], points.dtype), position.shape)
    return Manifold(distance, position, up)
