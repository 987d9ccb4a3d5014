"""The bundled objects, each a function that returns a closed solid in metres, real-life size.

Bodies stand or lie along the axes; z is up as one would put them on a table.
"""

from collections.abc import Callable

import numpy as np

from gmdx_assets.parametric.csg import combine, outline
from gmdx_assets.parametric.solids import (
    Floats,
    Solid,
    arc,
    bend,
    densify,
    extrude,
    loft,
    lofted,
    revolve,
    superellipse,
    sweep,
)

MM = 1e-3


def _profile(*points: tuple[float, float], step: float) -> Floats:
    """A revolved profile from radii and heights in mm, no segment longer than `step` mm."""
    return densify(np.array(points, float), step) * MM


def mug() -> Solid:
    """A hollow mug, 95 mm high and 82 mm wide, with a handle."""
    body = revolve(
        _profile((0, 0), (37, 0), (40, 3), (41, 10), (41, 93), (40, 95), (0, 95), step=14),
        segments=36,
    )
    bore = revolve(
        _profile((0, 6), (33, 6), (36, 9), (37, 14), (37, 92), (38, 96), (0, 96), step=14),
        segments=36,
    )
    angle = np.radians(np.linspace(-98, 98, 15))
    path = np.stack([38 + 30 * np.cos(angle), 49 + 29 * np.sin(angle)], axis=1) * MM
    handle = sweep(path, superellipse(4.2, 7.0, 2.6, 12) * MM, step=4 * MM)
    return combine([body, handle], [bore], shortest=1.5 * MM, tolerance=0.2 * MM)


def bottle() -> Solid:
    """A closed half-litre bottle with its cap on: solid, as if full; 212 mm high."""
    shoulder = [(33 - 10 * (1 - np.cos(t)) - 10 * t / 1.4, 135 + 34 * np.sin(t) ** 1.2)
                for t in np.linspace(0.2, 1.4, 6)]  # fmt: skip
    profile = _profile(
        (0, 3), (18, 2), (24, 0), (30, 1), (33, 5), (33, 55), (31.5, 60), (31.5, 80), (33, 85),
        (33, 135), *shoulder, (12.5, 178), (12.5, 188), (15, 189), (15, 211), (14, 212), (0, 212),
        step=10.5,
    )  # fmt: skip
    return revolve(profile, segments=36)


def bowl() -> Solid:
    """A hollow bowl on a foot, 140 mm wide and 62 mm high, wall 5 mm."""
    outer_angle = np.radians(np.linspace(28, 90, 8))
    inner_angle = np.radians(np.linspace(90, 0, 9))
    outer = np.stack([70 * np.sin(outer_angle), 60 - 56 * np.cos(outer_angle)], axis=1)
    inner = np.stack([65 * np.sin(inner_angle), 60 - 51 * np.cos(inner_angle)], axis=1)
    inner[-1, 0] = 0.0
    foot = np.array([(0, 3), (26, 3), (27, 0), (31.5, 0)], float)
    lip = np.array([(69, 61.5), (66.5, 61.5)], float)
    profile = densify(np.concatenate([foot, outer, lip, inner]), 11) * MM
    return revolve(profile, segments=36)


def hammer() -> Solid:
    """An engineer's hammer with a cross peen, 280 mm long; the handle goes through the head."""
    across = [
        (-52, 13, 13, 2.0), (-50, 15, 15, 2.0), (-38, 15, 15, 2.0), (-32, 11.5, 11.5, 2.2),
        (-22, 11.5, 11.5, 3.0), (-15, 13.5, 14, 6.0), (15, 13.5, 14, 6.0), (30, 12.5, 10, 6.0),
        (45, 12, 6, 6.0), (58, 12, 2.5, 5.0), (60, 11, 1.2, 4.0),
    ]  # fmt: skip
    head = []
    for x, y_radius, z_radius, power in densify(np.array(across), 8):
        flat = superellipse(y_radius, z_radius, power, 16)
        head.append(np.column_stack([np.full(16, x), flat]) * MM)
    along = [
        (-262, 8, 12), (-255, 11, 15.5), (-225, 11.5, 16), (-190, 11, 15), (-150, 9, 12.5),
        (-105, 7.5, 11), (-65, 7.5, 10.5), (-30, 8.5, 11), (-10, 8.5, 11), (14, 8.5, 11),
        (19, 8.2, 10.6),
    ]  # fmt: skip
    handle = []
    for z, y_radius, x_radius in densify(np.array(along), 11):
        flat = superellipse(x_radius, y_radius, 2.2, 14)
        handle.append(np.column_stack([flat, np.full(14, z)]) * MM)
    solids = [lofted(head, 6 * MM), lofted(handle, 6 * MM)]
    return combine(solids, shortest=1.2 * MM, tolerance=0.2 * MM)


def spanner() -> Solid:
    """A combination spanner for 17 mm nuts, 208 mm long: an open jaw and a ring."""
    shaft = np.array([[0, -6.5], [170, -5.5], [170, 5.5], [0, 6.5]])
    jaw_head = arc((0, 0), 19, 0, 360, 41)[:-1] * [1.0, 0.95]
    ring_head = arc((176, 0), 13.5, 0, 360, 37)[:-1]
    tilt = np.radians(180 - 15)
    turn = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
    slot = np.concatenate([[[30, -8.5], [30, 8.5]], arc((-1, 0), 8.5, 90, 270, 9)])
    nut = arc((176, 0), 8.6 / np.cos(np.pi / 6), 0, 360, 7)[:-1]
    loops = outline([shaft, jaw_head, ring_head], [slot @ turn, nut], fillet=9.0, detail=0.15)
    return extrude([loop * MM for loop in loops], 8 * MM, step=5.5 * MM)


def bracket() -> Solid:
    """A bent sheet-metal angle, legs of 58 and 52 mm, 45 mm wide, 5 mm thick, a hole in each."""
    half, corner, radius = 22.5, 6.0, 6.0
    low, high = -52.0, 56.0
    rows = np.linspace(-0.25, 1.25, 7) * radius * np.pi / 2
    plate = np.concatenate(
        [
            arc((low + corner, -half + corner), corner, 180, 270, 5),
            np.column_stack([rows, np.full(7, -half)]),
            arc((high - corner, -half + corner), corner, -90, 0, 5),
            arc((high - corner, half - corner), corner, 0, 90, 5),
            np.column_stack([rows[::-1], np.full(7, half)]),
            arc((low + corner, half - corner), corner, 90, 180, 5),
        ]
    )
    holes = [arc(center, 5.5, 15, -345, 13)[:-1] for center in [(-27, 0), (33, 0)]]
    # Points in rows across the bend keep its triangles from crossing the fold.
    across = np.linspace(-half, half, 10)[1:-1]
    extra = np.stack(np.meshgrid(rows, across), axis=-1).reshape(-1, 2)
    loops = [loop * MM for loop in (plate, *holes)]
    flat = extrude(loops, 5 * MM, step=6 * MM, extra=extra * MM)
    return bend(flat.moved((0, 0, -2.5 * MM)), radius * MM, np.pi / 2)


def gear() -> Solid:
    """An involute spur gear: module 3, 18 teeth, 14 mm thick, bore of 14 mm with a keyway."""
    teeth, module, pressure = 18, 3.0, np.radians(20)
    pitch = teeth * module / 2
    base, tip, root = pitch * np.cos(pressure), pitch + module, pitch - 1.25 * module
    radius = np.linspace(base, tip, 5)
    roll = np.sqrt((radius / base) ** 2 - 1)
    involute = roll - np.arctan(roll)
    half = np.pi / (2 * teeth) + np.tan(pressure) - pressure - involute
    flank = np.concatenate([[[root, half[0] + 0.02]], np.column_stack([radius, half])])
    tooth = np.concatenate([flank * [1.0, -1.0], flank[::-1]])
    polar = np.concatenate([tooth + np.array([0, 2 * np.pi * i / teeth]) for i in range(teeth)])
    rim = polar[:, :1] * np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], axis=1)
    bore = arc((0, 0), 7, 70, -250, 24)
    key = np.array([[-2.4, 9.3], [2.4, 9.3]])
    loops = [rim * MM, np.concatenate([bore, key]) * MM]
    return extrude(loops, 14 * MM, step=5 * MM)


def ring() -> Solid:
    """A torus: 60 mm across the middle of its tube, tube 16 mm thick."""
    angle = 2 * np.pi * np.arange(16) / 16
    profile = np.stack([30 + 8 * np.cos(angle), 8 * np.sin(angle)], axis=1) * MM
    return revolve(profile, segments=48, closed=True).moved((0, 0, 8 * MM))


def dumbbell() -> Solid:
    """A one-piece dumbbell, 170 mm long: two chamfered discs of 56 mm on a bar of 26 mm."""
    profile = _profile(
        (0, 0), (24, 0), (28, 4), (28, 36), (24, 40), (13, 40), (13, 130), (24, 130), (28, 134),
        (28, 166), (24, 170), (0, 170), step=9,
    )  # fmt: skip
    return revolve(profile, segments=32)


def cup() -> Solid:
    """A hollow tapered beaker, 110 mm high, 76 mm wide at the mouth, wall 3 mm."""
    profile = _profile(
        (0, 0), (24, 0), (26, 2), (37.8, 109), (37, 110), (35.6, 110), (34.8, 109), (23.5, 5),
        (22.5, 4), (0, 4), step=12,
    )  # fmt: skip
    return revolve(profile, segments=36)


def l_profile() -> Solid:
    """A piece of angle section, 40 x 40 x 6 mm, 100 mm long, sharp-cornered."""
    corner = np.array([(0, 0), (40, 0), (40, 6), (6, 6), (6, 40), (0, 40)], float)
    return extrude([corner * MM], 100 * MM, step=8.4 * MM)


def cross() -> Solid:
    """A plus sign: two bars of 90 x 26 mm, 22 mm thick."""
    a, b = 13.0, 45.0
    plus = [(a, -b), (a, -a), (b, -a), (b, a), (a, a), (a, b), (-a, b), (-a, a), (-b, a),
            (-b, -a), (-a, -a), (-a, -b)]  # fmt: skip
    return extrude([np.array(plus) * MM], 22 * MM, step=6.6 * MM)


def egg() -> Solid:
    """A hen's egg: half an ellipsoid of 25 mm under one of 33 mm, 45 mm wide."""
    angle = np.radians(np.linspace(-90, 90, 21))
    height = np.where(angle < 0, 25.0, 33.0)
    profile = np.stack([22.5 * np.cos(angle), 25 + height * np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    return revolve(profile * MM, segments=32)


def plate() -> Solid:
    """A thin plate, 120 x 80 x 5 mm, its corners rounded to 10 mm."""
    x, y, r = 50.0, 30.0, 10.0
    rim = np.concatenate(
        [arc((x * sx, y * sy), r, 90 * q, 90 * q + 90, 6)
         for q, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)])]
    )  # fmt: skip
    return extrude([rim * MM], 5 * MM, step=7.5 * MM)


def screw() -> Solid:
    """A hexagon-head coach screw, 16 x 80 mm, with a right-handed thread of 8 mm pitch."""
    pitch, crest, core, per_turn = 8.0, 8.0, 6.0, 12
    ridge = np.array([1, 1, 0.35, 0, 0, 0, 0, 0, 0, 0, 0, 0.35])
    sections: list[Floats] = []

    def add(radius: Floats, z: float, twist: float) -> None:
        angle = twist + 2 * np.pi * np.arange(len(radius)) / len(radius)
        flat = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sections.append(np.column_stack([flat, np.full(len(radius), z)]) * MM)

    # The section turns as it rises, so its points stay on the ridge: 6.5 turns of thread.
    for i in range(int(6.5 * per_turn) + 1):
        z = -78.0 + i * pitch / per_turn
        height = (crest - core) * np.clip(min(z + 76.0, -26.0 - z) / 4.0, 0, 1)
        thin = core - 3.0 * np.clip((-72.0 - z) / 6.0, 0, 1)
        add(thin + height * ridge, z, 2 * np.pi * i / per_turn)
    for z in (-24.0, -18.0, -12.0, -6.0, 0.0):
        add(np.full(24, crest), z, np.pi)
    turn = 2 * np.pi * np.arange(24) / 24
    hexagon = 12.0 / np.cos((turn + np.pi / 6) % (np.pi / 3) - np.pi / 6)
    for across, z in [(0.97, 0.0), (1.0, 0.6), (1.0, 5.0), (1.0, 9.2), (0.93, 10.5)]:
        add(hexagon * across, z, np.pi)
    return lofted(sections, 4 * MM)


def spoon() -> Solid:
    """A table spoon, 195 mm long: a hollowed bowl of 42 mm and a curved, widening handle."""
    tip = 32 * (1 - np.cos(np.linspace(0.22, 2.75, 15)))
    tail = 192 + 3 * np.sin(np.linspace(0, 1.2, 3))
    x = np.concatenate([tip, np.linspace(tip[-1] + 5, 186, 17), tail])
    hollow = np.clip(1 - ((x - 32) / 32.5) ** 2, 0, 1)
    grown = np.clip((x - 40) / 24, 0, 1) ** 2
    end = np.sqrt(np.clip(1 - (np.maximum(x - 185, 0) / 10.5) ** 2, 0, 1))
    half = grown * end * (4.0 + 4.5 * np.clip((x - 64) / 110, 0, 1) ** 1.4)
    half = ((21 * np.sqrt(hollow)) ** 4 + half**4) ** 0.25
    rise = 16 * np.sin(np.pi * np.clip((x - 50) / 165, 0, 1)) ** 1.5
    thick = 1.2 + 0.9 * np.exp(-(((x - 72) / 22) ** 2))
    sections = [np.array([[0.0, 0.0, rise[0]]])]
    for i in range(len(x)):
        turn = np.linspace(0, 2 * np.pi, 17 if x[i] < 66 else 9)[:-1]
        y, up = np.cos(turn), np.sin(turn)
        dish = -11 * hollow[i] * np.clip(half[i] / 21, 0, 1) * (1 - y**2)
        z = rise[i] + dish + thick[i] * up
        sections.append(np.column_stack([np.full(len(turn), x[i]), half[i] * y, z]))
    sections.append(np.array([[195.2, 0.0, rise[-1]]]))
    return loft([section * MM for section in sections])


SHAPES: dict[str, Callable[[], Solid]] = {
    shape.__name__: shape
    for shape in (
        mug, bottle, bowl, hammer, spanner, bracket, gear, ring,
        dumbbell, cup, l_profile, cross, egg, plate, screw, spoon,
    )
}  # fmt: skip
