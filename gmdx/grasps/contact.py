"""Intersection-line analysis: where the pads of a closing gripper would first touch.

A grid of lines parallel to the closing axis is spread over the pad's face and intersected
with the object's surface (CoRL 2022, GMD; metrics 6 and 8 to 15).
"""

from dataclasses import dataclass, replace

import numpy as np
from gmdx_kernels.closing_lines import FirstTouch, closing_lines, pad_grid

from gmdx.arrays import Array, Float, Int
from gmdx.errors import ConfigError
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.objects.surface import surface_of
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene

_WORLD_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class LineConfig:
    """How lines sample a pad's face, and what a compliant pad touches.

    A rubber pad 3 mm thick of 1 MPa sinks in by 0.15 mm under 20 N spread over its face, and by
    about 1.5 mm (Hertz) on a ball of 30 mm; a rigid one not at all. A millimetre lies between:
    on the bundled objects, tolerances of 0.5 to 1 mm come nearest to where simulated pads touch,
    and of these the larger one's quality tells more of success.
    """

    grid: tuple[int, int] = (5, 5)  # lines across the pad and along it, from edge to edge
    touch_tolerance: float = 1e-3  # m, behind a pad's first touch that still belongs to it

    def __post_init__(self) -> None:
        if min(self.grid) < 1 or not self.touch_tolerance >= 0:
            raise ConfigError(
                f"lines need a grid of 1 x 1 or more, not {self.grid}, and a touch_tolerance of 0 "
                f"or more, not {self.touch_tolerance}"
            )


@dataclass(frozen=True)
class ClosingContacts:
    """Analytical contacts of a batch of grasps, in the object's frame."""

    center: PadContacts  # k = 1: the closing line through the grasp's centre
    pads: PadContacts  # k = lines of the grid: every first-touch point of each pad

    def __getitem__(self, rows: slice | Int[Array, "m"]) -> "ClosingContacts":
        """The contacts of some of the grasps."""
        return replace(self, center=self.center[rows], pads=self.pads[rows])


def closing_contacts(
    scene: Scene, grasps: PlanarGrasp, *, gripper: Gripper, config: LineConfig | None = None
) -> ClosingContacts:
    """Where the pads would first touch the object's surface if nothing moved while they close.

    For the pads only what lies between them while open counts, and a line whose pad stands
    inside the object touches nothing; the line through the centre comes from outside the
    object on either side. A grasp that no line meets has no valid contact (NaN).

    Args:
        scene: The object at rest.
        grasps: n grasps of that scene.
        gripper: Its pads' faces are sampled.
        config: The grid and the tolerance.
    """
    config = LineConfig() if config is None else config
    obj = scene.object
    center = scene.to_object(grasps.center)
    axis = scene.direction_to_object(grasps.axis)
    up = np.broadcast_to(scene.direction_to_object(_WORLD_UP), center.shape)
    normals = -surface_of(obj.vertices, obj.faces).normals

    def meet(offsets: Float[Array, "l 2"], width: Float[Array, "n"]) -> _Touched:
        touch = closing_lines(obj.vertices, obj.faces, center, axis, up, width, offsets=offsets)
        lines = center[:, None] + _across(offsets, axis, up)  # n l 3
        return _Touched(_contacts(touch, lines, axis, normals), touch)

    # Longer than the object from wherever the grasp's centre lies.
    through = 2.0 * (np.linalg.norm(center, axis=1) + obj.radius) + 1e-3
    pads = meet(pad_grid(gripper.pad_size, config.grid), grasps.width)
    return ClosingContacts(
        center=meet(np.zeros((1, 2)), through).contacts,
        pads=_first_touches(pads, config.touch_tolerance),
    )


@dataclass(frozen=True)
class _Touched:
    contacts: PadContacts  # k = lines
    touch: FirstTouch


def _across(
    offsets: Float[Array, "l 2"], axis: Float[Array, "n 3"], up: Float[Array, "n 3"]
) -> Float[Array, "n l 3"]:
    """Where each line crosses the plane through the centre, relative to the centre, m."""
    side = np.cross(up, axis)
    across: Array = offsets[:, :1] * side[:, None] + offsets[:, 1:] * up[:, None]
    return across


def _contacts(
    touch: FirstTouch,
    lines: Float[Array, "n l 3"],
    axis: Float[Array, "n 3"],
    normals: Float[Array, "f 3"],
) -> PadContacts:
    valid = touch.triangle >= 0
    points = lines[:, None] + touch.distance[..., None] * axis[:, None, None]
    return PadContacts(points, np.where(valid[..., None], normals[touch.triangle], np.nan), valid)


def _first_touches(touched: _Touched, tolerance: float) -> PadContacts:
    """Drop what lies further than `tolerance` behind the first touch of its pad."""
    travel = touched.touch.distance * np.array([1.0, -1.0])[:, None]
    everything, valid = touched.contacts, touched.contacts.valid
    first = np.where(valid, travel, np.inf).min(axis=2, keepdims=True)
    valid = valid & (np.where(valid, travel, np.inf) <= first + tolerance)
    keep = valid[..., None]
    return PadContacts(
        np.where(keep, everything.points, np.nan),
        np.where(keep, everything.normals, np.nan),
        valid,
    )
