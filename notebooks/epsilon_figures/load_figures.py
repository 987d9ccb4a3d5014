"""Pictures of loads on an object: the worst wrench of a grasp, and its weight."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from epsilon_figures.stage import (
    PADS,
    closing_line,
    draw_arrow,
    draw_legend,
    draw_stage,
    draw_turning,
)
from gmdx.arrays import Array, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon import Epsilon, Strength, directional_strength, gravity_wrench
from gmdx.pictures.figure import INK, DrawConfig, new_figure
from gmdx.scenes.scene import Scene
from gmdx.studies.epsilon import Contacts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOAD, _WEIGHT = "#b3202a", "#1b8a3a"
_SIZE = DrawConfig(width=1100, height=520)


@dataclass(frozen=True)
class TiltStrength:
    """The heaviest object that a grasp holds, by the direction in which gravity pulls."""

    angle: Float[Array, "n"]  # rad, by which the gripper is turned
    about_closing: Float[Array, "n"]  # kg, turned about the line between the contacts
    about_level: Float[Array, "n"]  # kg, turned about the level axis across that line
    grip: float  # N, sum of the normal forces


def draw_worst_wrench(
    scene: Scene,
    contacts: Contacts,
    found: Epsilon,
    *,
    grip: float = 40.0,
    config: DrawConfig | None = None,
) -> "Figure":
    """The load that breaks a grasp first: its force and its torque at the centre of mass.

    Contacts exert least along `found.direction`, so a load the other way is resisted least.

    Args:
        scene: The object as it lies.
        contacts: Two, in the object's frame.
        found: Their epsilon.
        grip: Sum of the normal forces, N.
        config: Size of the picture.

    Raises:
        MetricError: There are not two contacts, or they do not hold the object.
    """
    if not found.closure:
        raise MetricError("the grasp has no force closure: no load is the first to break it")
    figure = new_figure(_SIZE if config is None else config)
    axes = draw_stage(figure, (0.0, 0.0, 0.62, 0.98), scene, contacts)
    load = -found.direction
    force, torque = scene.rotation @ load[:3], scene.rotation @ load[3:]
    size = scene.object.radius
    # Both as long as their share of the wrench, torque having been divided by L.
    draw_arrow(axes, np.zeros(3), 1.5 * size * force, color=_LOAD)
    draw_turning(axes, 1.5 * size * torque, color=_LOAD)
    newtons = grip * found.upper * np.linalg.norm(load[:3])
    moment = grip * found.upper * np.linalg.norm(load[3:]) * contacts.torque_scale
    lines = [
        "the first load to break the grasp",
        "",
        rf"$\varepsilon$ = {found.upper:.4f}, proved to lie between",
        f"  {found.lower:.9f} and {found.upper:.9f}",
        "",
        f"with a grip of {grip:g} N:",
        f"  force {newtons:.2f} N (straight arrow)",
        f"  torque {1e3 * moment:.1f} N mm (curved arrow)",
    ]
    if moment > 0.0:
        cosine = np.abs(load[3:] @ closing_line(contacts)) / np.linalg.norm(load[3:])
        apart = np.degrees(np.arccos(min(1.0, cosine)))
        lines += ["", "torque's axis and closing line:", f"  {apart:.0f} degrees apart"]
    figure.text(0.64, 0.80, "\n".join(lines), fontsize=11.5, va="top", linespacing=1.35, color=INK)
    draw_legend(figure, {"load on the object": _LOAD})
    return figure


def tilt_strength(
    scene: Scene, contacts: Contacts, *, grip: float = 40.0, angles: int = 73
) -> TiltStrength:
    """The heaviest object that is held against its weight as gripper and object are turned.

    Args:
        scene: The object as it lies: gravity at angle 0.
        contacts: Two, in the object's frame.
        grip: Sum of the normal forces, N.
        angles: How many, from 0 to 2 pi.

    Raises:
        MetricError: There are not two contacts, or one is straight above the other.
    """
    line = closing_line(contacts)
    down = scene.direction_to_object(np.array([0.0, 0.0, -1.0]))
    level = np.cross(down, line)
    length = float(np.linalg.norm(level))
    if length < 1e-9:
        raise MetricError("the closing line is upright: no one level axis lies across it")
    level /= length
    angle = np.linspace(0.0, 2.0 * np.pi, angles)

    def heaviest(axis: Float[Array, "3"]) -> Float[Array, "n"]:
        held = [weight_strength(contacts, _turned(down, axis, -a)).value for a in angle]
        return grip * np.array(held)

    return TiltStrength(angle, heaviest(line), heaviest(level), grip)


def weight_strength(contacts: Contacts, down: Float[Array, "3"]) -> Strength:
    """The mass, kg, whose weight is resisted for each newton of grip, and by which forces."""
    return directional_strength(
        contacts.points, contacts.normals, **contacts.parameters, wrench=gravity_wrench(1.0, down)
    )


def draw_weight(
    scene: Scene,
    contacts: Contacts,
    tilts: TiltStrength,
    *,
    config: DrawConfig | None = None,
) -> "Figure":
    """The forces that hold the heaviest object in its pose, and how heavy in any other.

    Args:
        scene: The object as it lies.
        contacts: Two, in the object's frame.
        tilts: What they hold; its grip is used.
        config: Size of the picture.

    Raises:
        MetricError: There are not two contacts.
    """
    figure = new_figure(_SIZE if config is None else config)
    axes = draw_stage(figure, (-0.02, 0.0, 0.58, 0.96), scene, contacts)
    held = weight_strength(contacts, scene.direction_to_object(np.array([0.0, 0.0, -1.0])))
    weight = 9.81 * held.value
    length = 1.6 * scene.object.radius
    draw_arrow(axes, np.zeros(3), np.array([0.0, 0.0, -length * weight]), color=_WEIGHT)
    for point, force, color in zip(contacts.points, held.forces, PADS, strict=True):
        tip = scene.rotation @ point
        push = length * (scene.rotation @ force)
        draw_arrow(axes, tip - push, push, color=color)
    figure.text(
        0.03, 0.05,
        f"a grip of {tilts.grip:g} N holds {tilts.grip * held.value:.2f} kg in this pose",
        fontsize=11.5, color=INK,
    )  # fmt: skip
    polar = figure.add_axes((0.60, 0.20, 0.36, 0.64), projection="polar")
    _show_tilts(polar, tilts)
    figure.text(
        0.78, 0.945, f"heaviest object held (kg) with a grip of {tilts.grip:g} N", fontsize=11.5,
        ha="center", color=INK,
    )  # fmt: skip
    draw_legend(figure, {"heaviest weight held": _WEIGHT})
    return figure


def _show_tilts(axes: "Axes", tilts: TiltStrength) -> None:
    curves = (
        ("about the closing line", tilts.about_closing, "#34567f", "-"),
        ("about the level line across it", tilts.about_level, "#e08a1e", (0, (5, 2))),
    )
    for name, mass, color, style in curves:
        axes.plot(tilts.angle, mass, color=color, linestyle=style, linewidth=2, label=name)
    axes.set_theta_zero_location("S")  # type: ignore[attr-defined]
    axes.set_rlabel_position(0)  # type: ignore[attr-defined]
    axes.set_ylim(0, None)
    axes.tick_params(labelsize=10, color=INK, labelcolor=INK)
    axes.grid(color="0.88", linewidth=0.7)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.08), fontsize=11, frameon=False, labelcolor=INK,
        title="gripper and object turned", title_fontsize=11,
    )  # fmt: skip


def _turned(v: Float[Array, "3"], axis: Float[Array, "3"], angle: float) -> Float[Array, "3"]:
    """Rodrigues's rotation of v about a unit axis."""
    turned: Array = (
        np.cos(angle) * v
        + np.sin(angle) * np.cross(axis, v)
        + (1.0 - np.cos(angle)) * (axis @ v) * axis
    )
    return turned
