"""Contacts between an edge of a hull and an edge of a pad, as C MuJoCo finds them.

Where the two edges cross, C MuJoCo lays the hull's edge on the pad's face if it is almost parallel
to it: two contacts with the face's normal. MuJoCo Warp only tries the pad's edge on the hull's
faces, and is left with one contact at the crossing, whose normal is up to 5 degrees off and which
does not keep the object from turning. These kernels do what it leaves out.
"""

# ruff: noqa: UP018, RUF046 (Warp takes a literal for a constant: a variable is declared by a cast)
import math
from typing import Any, no_type_check

import numpy as np
import warp as wp
from mujoco.mjx.third_party.mujoco_warp._src.collision_core import write_contact
from mujoco.mjx.third_party.mujoco_warp._src.math import make_frame
from mujoco.mjx.third_party.mujoco_warp._src.types import GeomType, vec5

_PARALLEL = wp.constant(math.sin(0.0889))  # of edge and face, as in MuJoCo
_NOISE = wp.constant(1.5e-8)  # m, of witness points: a contact's normal is known to noise / depth
_BOX, _MESH = wp.constant(int(GeomType.BOX)), wp.constant(int(GeomType.MESH))


@no_type_check
@wp.kernel(enable_backward=False)
def mark_several(
    nacon: wp.array[int],
    naconmax: int,
    geom: wp.array[wp.vec2i],
    worldid: wp.array[int],
    number: wp.array[int],
    box_of_geom: wp.array[int],
    several: wp.array3d[int],
):
    """Mark each pair of a box and a mesh that has more than one contact."""
    contact = wp.tid()
    if contact >= wp.min(nacon[0], naconmax) or number[contact] == 0:
        return
    pair = geom[contact]
    box = box_of_geom[pair[0]]
    if box >= 0:
        several[worldid[contact], box, pair[1]] = 1


@no_type_check
@wp.kernel(enable_backward=False)
def lay_edges(
    before: wp.array[int],
    naconmax: int,
    geom_type: wp.array[int],
    geom_dataid: wp.array2d[int],
    geom_size: wp.array2d[wp.vec3],
    mesh_vertadr: wp.array[int],
    mesh_vertnum: wp.array[int],
    mesh_vert: wp.array[wp.vec3],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    box_of_geom: wp.array[int],
    several: wp.array3d[int],
    contact_dist: wp.array[float],
    contact_pos: wp.array[wp.vec3],
    contact_frame: wp.array[wp.mat33],
    contact_includemargin: wp.array[float],
    contact_friction: wp.array[vec5],
    contact_solref: wp.array[wp.vec2],
    contact_solreffriction: wp.array[wp.vec2],
    contact_solimp: wp.array[vec5],
    contact_dim: wp.array[int],
    contact_geom: wp.array[wp.vec2i],
    contact_efc_address: wp.array2d[int],
    contact_worldid: wp.array[int],
    contact_type: wp.array[int],
    contact_geomcollisionid: wp.array[int],
    contact_adhesion: wp.array[float],
    nacon: wp.array[int],
):
    """Lay a hull's edge on a box's face where the two have one contact at an edge."""
    contact = wp.tid()
    if contact >= wp.min(before[0], naconmax):
        return
    pair = contact_geom[contact]
    box = pair[0]
    mesh = pair[1]
    world = contact_worldid[contact]
    if geom_type[box] != _BOX or geom_type[mesh] != _MESH or box_of_geom[box] < 0:
        return
    if several[world, box_of_geom[box], mesh] != 0:
        return
    normal = contact_frame[contact][0]

    # The hull's edge: its vertex deepest in the box, and the one that lies flattest with it.
    turn = geom_xmat[world, mesh]
    along = wp.transpose(turn) @ normal
    data = geom_dataid[world, mesh]
    first = mesh_vertadr[data]
    deepest = first
    lowest = wp.dot(mesh_vert[first], along)
    for i in range(1, mesh_vertnum[data]):
        height = wp.dot(mesh_vert[first + i], along)
        if height < lowest:
            lowest = height
            deepest = first + i
    other = int(-1)
    noise = wp.max(1.0e-5, _NOISE / wp.max(-contact_dist[contact], 1.0e-9))
    flattest = noise
    for i in range(mesh_vertnum[data]):
        if first + i != deepest:
            gap = mesh_vert[first + i] - mesh_vert[deepest]
            slope = wp.dot(gap, along) / wp.length(gap)
            if slope < flattest:
                flattest = slope
                other = first + i
    if other < 0:
        return  # a vertex of the hull
    line = wp.normalize(mesh_vert[other] - mesh_vert[deepest])
    for i in range(mesh_vertnum[data]):
        if first + i != deepest:
            gap = mesh_vert[first + i] - mesh_vert[deepest]
            long = wp.length(gap)
            if wp.dot(gap, along) < noise * long and wp.length(wp.cross(gap, line)) > 0.02 * long:
                return  # a face of the hull

    # In the box's own axes.
    to_box = wp.transpose(geom_xmat[world, box])
    half = geom_size[world, box]
    move = geom_xpos[world, mesh] - geom_xpos[world, box]
    start = to_box @ (turn @ mesh_vert[deepest] + move)
    way = to_box @ (turn @ (mesh_vert[other] - mesh_vert[deepest]))
    out = to_box @ normal
    if wp.min(wp.min(wp.abs(out[0]), wp.abs(out[1])), wp.abs(out[2])) > 10.0 * noise:
        return  # a vertex of the box
    edge = wp.normalize(way)
    face = int(-1)
    facing = float(wp.max(1.0e-4, 10.0 * noise))  # a normal's noise points at no face
    for axis in range(3):
        if wp.abs(out[axis]) > facing and wp.abs(edge[axis]) < _PARALLEL:
            facing = wp.abs(out[axis])
            face = axis
    if face < 0:
        return

    # The part of the edge that is over the face.
    lo = float(0.0)
    hi = float(1.0)
    for axis in range(3):
        if axis != face:
            if wp.abs(way[axis]) < 1.0e-12:
                if wp.abs(start[axis]) > half[axis]:
                    hi = -1.0
            else:
                near = (-half[axis] - start[axis]) / way[axis]
                far = (half[axis] - start[axis]) / way[axis]
                lo = wp.max(lo, wp.min(near, far))
                hi = wp.min(hi, wp.max(near, far))
    if lo > hi:
        return
    side = wp.sign(out[face])
    end_0 = start + lo * way
    end_1 = start + hi * way
    depth_0 = side * end_0[face] - half[face]
    depth_1 = side * end_1[face] - half[face]
    second = bool(True)
    if depth_0 >= 0.0 and depth_1 >= 0.0:
        return
    # The edge lies within _PARALLEL of the face: it cannot be deeper than that lets it be.
    lowest_end = contact_dist[contact] - 2.0 * _PARALLEL * wp.length(end_1 - end_0)
    if wp.min(depth_0, depth_1) < lowest_end:
        return
    # An end below the face counts once if it is a vertex, and twice if the face's border cut it
    # off, as in C's clipped polygon.
    if depth_0 >= 0.0:
        second = hi < 1.0
        end_0 = end_1
        depth_0 = depth_1
    elif depth_1 >= 0.0:
        second = lo > 0.0
        end_1 = end_0
        depth_1 = depth_0

    outward = wp.vec3(0.0, 0.0, 0.0)
    outward[face] = side
    to_world = geom_xmat[world, box]
    frame = make_frame(to_world @ outward)
    center = geom_xpos[world, box]
    contact_dist[contact] = depth_0
    contact_pos[contact] = center + to_world @ (end_0 - 0.5 * depth_0 * outward)
    contact_frame[contact] = frame
    if second:
        write_contact(
            naconmax,
            1,
            depth_1,
            center + to_world @ (end_1 - 0.5 * depth_1 * outward),
            frame,
            contact_includemargin[contact],
            0.0,
            contact_dim[contact],
            contact_friction[contact],
            contact_solref[contact],
            contact_solreffriction[contact],
            contact_solimp[contact],
            contact_adhesion[contact],
            pair,
            wp.vec2i(-1, -1),
            world,
            contact_dist,
            contact_pos,
            contact_frame,
            contact_includemargin,
            contact_friction,
            contact_solref,
            contact_solreffriction,
            contact_solimp,
            contact_dim,
            contact_geom,
            contact_efc_address,
            contact_worldid,
            contact_type,
            contact_geomcollisionid,
            contact_adhesion,
            nacon,
        )


class EdgeContacts:
    """MuJoCo Warp's callback between finding contacts and making constraints of them."""

    def __init__(self, geom_type: Any) -> None:
        """Number the boxes among geoms of these types."""
        boxes = np.asarray(geom_type) == int(GeomType.BOX)
        self.boxes = int(boxes.sum())
        self.box_of_geom = wp.array(np.where(boxes, np.cumsum(boxes) - 1, -1), dtype=int)
        self.scratch: dict[int, tuple[Any, Any]] = {}  # by number of worlds

    def __call__(self, model: Any, data: Any) -> None:
        """Add what is missing to the contacts of all worlds."""
        if data.nworld not in self.scratch:
            shape = (data.nworld, self.boxes, model.ngeom)
            self.scratch[data.nworld] = wp.zeros(shape, dtype=int), wp.zeros(1, dtype=int)
        several, before = self.scratch[data.nworld]
        contact = data.contact
        several.zero_()
        wp.copy(before, data.nacon)
        wp.launch(
            mark_several,
            dim=data.naconmax,
            inputs=[
                before,
                data.naconmax,
                contact.geom,
                contact.worldid,
                contact.geomcollisionid,
                self.box_of_geom,
            ],
            outputs=[several],
        )
        wp.launch(
            lay_edges,
            dim=data.naconmax,
            inputs=[
                before,
                data.naconmax,
                model.geom_type,
                model.geom_dataid,
                model.geom_size,
                model.mesh_vertadr,
                model.mesh_vertnum,
                model.mesh_vert,
                data.geom_xpos,
                data.geom_xmat,
                self.box_of_geom,
                several,
            ],
            outputs=[
                contact.dist,
                contact.pos,
                contact.frame,
                contact.includemargin,
                contact.friction,
                contact.solref,
                contact.solreffriction,
                contact.solimp,
                contact.dim,
                contact.geom,
                contact.efc_address,
                contact.worldid,
                contact.type,
                contact.geomcollisionid,
                contact.adhesion,
                data.nacon,
            ],
        )
