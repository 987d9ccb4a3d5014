"""The metrics' formulas: pure functions on contacts, poses and outcomes of n grasps.

Definitions and numbers: `gmdx.metrics.table`; source: Fusing Priori and Posteriori Metrics for
Automatic Dataset Annotation of Planar Grasping (CoRL 2022). What does not exist for a grasp is
NaN. The `_norm` columns are made of the others by `normalised`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.geometry import axis_angle_between, quaternion_matrix, rotation_angle
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.metrics.table import METRIC_NAMES
from gmdx.objects.model import ObjectModel
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import Snapshot, TrialResults


@dataclass(frozen=True)
class ContactPair:
    """The grasp that two pads' mean contact points make; NaN without contact on both."""

    middle: Float[Array, "n 3"]  # m
    axis: Float[Array, "n 3"]  # m, from pad 0 to pad 1, not normalised

    @property
    def width(self) -> Float[Array, "n"]:
        """Distance between the two points, m."""
        width: Array = np.linalg.norm(self.axis, axis=1)
        return width


def contact_pair(contacts: PadContacts) -> ContactPair:
    """The mean contact points of both pads as a grasp."""
    means = contacts.means
    return ContactPair(0.5 * (means[:, 0] + means[:, 1]), means[:, 1] - means[:, 0])


def object_metrics(obj: ObjectModel, n: int) -> dict[str, Array]:
    """Metrics 0 to 3: the object's oriented box, the same for all n grasps."""
    longest, middle, shortest = obj.box.extents
    return {
        "bound_x": np.full(n, longest),
        "bound_y": np.full(n, middle),
        "bound_l": np.full(n, shortest),
        "bound_r": np.full(n, longest / shortest),
    }


def analytical_metrics(
    pair: ContactPair, scene: Scene, grasps: PlanarGrasp
) -> dict[str, Float[Array, "n"]]:
    """Metrics 8, 10, 12, 13: where the pads would first touch, in the object's frame."""
    center, axis = scene.to_object(grasps.center), scene.direction_to_object(grasps.axis)
    return {
        "real_d_width": pair.width,
        "real_d_dis": np.linalg.norm(pair.middle, axis=1),
        "real_d_offset_l": np.linalg.norm(pair.middle - center, axis=1),
        "real_d_offset_a": _axes_angle(pair.axis, axis),
    }


def simulative_metrics(
    pair: ContactPair, obj: ObjectModel, grasps: PlanarGrasp, trials: TrialResults
) -> dict[str, Float[Array, "n"]]:
    """Metrics 16, 18, 20, 22, 28: what the contacts at the end of closing say, object's frame."""
    # The grasp was meant for the object at rest: that pose takes it into the object's frame.
    rest = quaternion_matrix(trials.object_quaternion[:, Snapshot.START])
    away = grasps.center - trials.object_position[:, Snapshot.START]
    center = np.einsum("nji,nj->ni", rest, away)
    axis = np.einsum("nji,nj->ni", rest, grasps.axis)
    return {
        "real_s_width": pair.width,
        "real_s_dis": np.linalg.norm(pair.middle - obj.box.center, axis=1),
        "real_s_offset_l": np.linalg.norm(pair.middle - center, axis=1),
        "real_s_offset_a": _axes_angle(pair.axis, axis),
        "sim_width": trials.opening,
    }


def comparative_metrics(
    simulative: ContactPair, analytical: ContactPair
) -> dict[str, Float[Array, "n"]]:
    """Metrics 32 and 34: how far the trial's contacts are from the predicted ones."""
    return {
        "g_offset_l": np.linalg.norm(simulative.middle - analytical.middle, axis=1),
        "g_offset_a": _axes_angle(simulative.axis, analytical.axis),
    }


def motion_metrics(trials: TrialResults) -> dict[str, Float[Array, "n"]]:
    """Metrics 24 to 26: how the object moved; the gripper does not turn, nor does its frame."""
    position, turn = trials.object_position, trials.object_quaternion
    shift = position[:, Snapshot.CLOSED] - position[:, Snapshot.CLOSING]
    return {
        "clo_ori_comfort": rotation_angle(turn[:, Snapshot.CLOSING], turn[:, Snapshot.CLOSED]),
        "lif_ori_stability": rotation_angle(turn[:, Snapshot.CLOSED], turn[:, Snapshot.HELD]),
        "moved": np.linalg.norm(shift, axis=1),
    }


def outcome_metrics(trials: TrialResults) -> dict[str, Float[Array, "n"]]:
    """Metrics 30, 31, 35: shares over the trials that say something; a diverged one does not."""
    valid = ~Outcome.is_failure(trials.outcome)
    count = valid.sum(axis=1)
    successes = (trials.outcome == Outcome.SUCCESS).sum(axis=1)
    hits = (trials.collision & valid).any(axis=1)
    return {
        "sim_success": np.where(count > 0, successes / np.maximum(count, 1), np.nan),
        "sim_coll": np.where(count > 0, hits.astype(float), np.nan),
        "force": trials.push_force,
    }


def outcome_columns(trials: TrialResults) -> dict[str, Array]:
    """What stands beside the outcome metrics: flags, counts, the nominal trial's outcome."""
    return {
        "force_is_lower_bound": trials.push_force_is_lower_bound,
        "valid_trials": (~Outcome.is_failure(trials.outcome)).sum(axis=1),
        "outcome": np.array([Outcome(o).label for o in trials.outcome[:, 0]], dtype=object),
    }


def normalised(
    values: Mapping[str, Float[Array, "n"]], lengths: Float[Array, "n"]
) -> dict[str, Float[Array, "n"]]:
    """The `_norm` column of each value that has one.

    Args:
        values: By name.
        lengths: m, `bound_l` of each grasp's object.
    """
    return {
        f"{name}_norm": value / lengths
        for name, value in values.items()
        if f"{name}_norm" in METRIC_NAMES
    }


def _axes_angle(a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Angles between axes, rad; NaN where one has no length, so no direction."""
    exists: Bool[Array, n] = (np.linalg.norm(a, axis=1) > 0) & (np.linalg.norm(b, axis=1) > 0)
    return np.where(exists, axis_angle_between(a, b), np.nan)
