"""The 36 metrics, declared once: everything that names a metric reads this table."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Kind = Literal["priori", "posteriori", "comparative"]
Stage = Literal["object", "grasp", "contact", "epsilon", "trial", "trial_epsilon"]

# In the order of their cost. Contacts are found before trials, and comparative metrics need both.
STAGES: tuple[Stage, ...] = ("object", "grasp", "contact", "epsilon", "trial", "trial_epsilon")
QUALITY_STAGES: tuple[Stage, ...] = ("epsilon", "trial_epsilon")
TRIAL_STAGES: tuple[Stage, ...] = ("trial", "trial_epsilon")  # of which trials are the input
STAGE_NEEDS: Mapping[Stage, tuple[Stage, ...]] = MappingProxyType(
    {
        "object": (),
        "grasp": ("object",),
        "contact": ("object",),
        "epsilon": ("contact",),
        "trial": ("contact",),
        "trial_epsilon": ("trial",),
    }
)


@dataclass(frozen=True)
class Metric:
    """One column of a dataset."""

    number: int  # the paper's
    name: str  # the paper's
    kind: Kind
    unit: str  # "" for a ratio or a count
    stage: Stage  # that pays for it
    definition: str

    @property
    def is_quality(self) -> bool:
        """Whether it is an epsilon quality, with proved bounds beside it."""
        return self.stage in QUALITY_STAGES


def _norm(number: int, of: Metric) -> Metric:
    return Metric(number, f"{of.name}_norm", of.kind, "", of.stage, f"{of.name} / bound_l")


_G_DIS = Metric(
    4, "g_dis", "priori", "m", "grasp", "distance from the grasp's centre to the centre of mass"
)
_D_WIDTH = Metric(
    8,
    "real_d_width",
    "priori",
    "m",
    "contact",
    "distance between the analytical grasp's two contact points",
)
_D_DIS = Metric(
    10,
    "real_d_dis",
    "priori",
    "m",
    "contact",
    "distance from the analytical contacts' midpoint to the centre of mass",
)
_D_OFFSET = Metric(
    12,
    "real_d_offset_l",
    "priori",
    "m",
    "contact",
    "distance from the analytical contacts' midpoint to the grasp's centre",
)
_S_WIDTH = Metric(
    16,
    "real_s_width",
    "posteriori",
    "m",
    "trial",
    "distance between the pads' mean contact points at the end of closing",
)
_S_DIS = Metric(
    18,
    "real_s_dis",
    "posteriori",
    "m",
    "trial",
    "distance from the simulative contacts' midpoint to the centre of the object's oriented box",
)
_S_OFFSET = Metric(
    20,
    "real_s_offset_l",
    "posteriori",
    "m",
    "trial",
    "distance from the simulative contacts' midpoint to the grasp's centre, in the object's frame",
)
_MOVED = Metric(
    26, "moved", "posteriori", "m", "trial", "shift of the centre of mass during closing"
)
_SIM_WIDTH = Metric(
    28,
    "sim_width",
    "posteriori",
    "m",
    "trial",
    "opening of the gripper at the end of closing, from its joints",
)
_G_OFFSET = Metric(
    32,
    "g_offset_l",
    "comparative",
    "m",
    "trial",
    "distance between the midpoints of the simulative and the analytical contacts",
)

METRICS: tuple[Metric, ...] = tuple(
    sorted(
        [
            Metric(0, "bound_x", "priori", "m", "object", "longest edge of the object's minimum-volume oriented box"),
            Metric(1, "bound_y", "priori", "m", "object", "middle edge of that box"),
            Metric(2, "bound_l", "priori", "m", "object", "shortest edge of that box: the L of every normalised column"),
            Metric(3, "bound_r", "priori", "", "object", "longest edge / shortest edge"),
            _G_DIS,
            _norm(5, _G_DIS),
            Metric(6, "g_quality", "priori", "", "epsilon", "epsilon quality of the two points where the closing line through the grasp's centre first meets the surface from either side"),
            Metric(7, "g_coll", "priori", "", "grasp", "1 if the open gripper at the grasp touches the object or the table"),
            _D_WIDTH,
            _norm(9, _D_WIDTH),
            _D_DIS,
            _norm(11, _D_DIS),
            _D_OFFSET,
            Metric(13, "real_d_offset_a", "priori", "rad", "contact", "angle between the analytical contacts' axis and the closing axis"),
            _norm(14, _D_OFFSET),
            Metric(15, "real_d_quality", "priori", "", "epsilon", "epsilon quality of the analytical grasp: all first-touch points of both pads"),
            _S_WIDTH,
            _norm(17, _S_WIDTH),
            _S_DIS,
            _norm(19, _S_DIS),
            _S_OFFSET,
            _norm(21, _S_OFFSET),
            Metric(22, "real_s_offset_a", "posteriori", "rad", "trial", "angle between the simulative contacts' axis and the closing axis, in the object's frame"),
            Metric(23, "real_s_quality", "posteriori", "", "trial_epsilon", "epsilon quality of the simulative grasp: its contact points and normals"),
            Metric(24, "clo_ori_comfort", "posteriori", "rad", "trial", "rotation of the object during closing"),
            Metric(25, "lif_ori_stability", "posteriori", "rad", "trial", "rotation of the object relative to the gripper during lift and hold"),
            _MOVED,
            _norm(27, _MOVED),
            _SIM_WIDTH,
            _norm(29, _SIM_WIDTH),
            Metric(30, "sim_success", "posteriori", "", "trial", "successes / trials that did not diverge"),
            Metric(31, "sim_coll", "posteriori", "", "trial", "1 if in any trial something other than a pad's face touches the object, or the gripper the table, before closing"),
            _G_OFFSET,
            _norm(33, _G_OFFSET),
            Metric(34, "g_offset_a", "comparative", "rad", "trial", "angle between the axes of the simulative and the analytical contacts"),
            Metric(35, "force", "posteriori", "N", "trial", "external force that pushed the lifted object out of the gripper; 0 if it was not lifted, or slipped out by itself"),
        ],
        key=lambda metric: metric.number,
    )
)  # fmt: skip

METRIC_NAMES: tuple[str, ...] = tuple(metric.name for metric in METRICS)


COMPARED = tuple(metric for metric in METRICS if metric.kind != "priori")
