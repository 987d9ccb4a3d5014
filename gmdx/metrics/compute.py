"""The 36 metrics of a batch of grasps, from contacts and trials.

Definitions: `gmdx.metrics.table`; source: Fusing Priori and Posteriori Metrics for Automatic
Dataset Annotation of Planar Grasping (CoRL 2022). What does not exist for a grasp is NaN.
"""

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.errors import MetricError
from gmdx.geometry import axis_angle_between, quaternion_matrix, rotation_angle
from gmdx.grasps.collide import collides
from gmdx.grasps.contact import LineConfig, closing_contacts
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.machine.devices import on_device
from gmdx.metrics.quality import Evidence, PadSet, QualityConfig, audit_sample, pad_qualities
from gmdx.metrics.table import METRIC_NAMES
from gmdx.objects.model import ObjectModel
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import Snapshot, TrialResults

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class MetricConfig:
    """How the metrics are computed."""

    lines: LineConfig = field(default_factory=LineConfig)  # of the analysis; sampling asks it too
    quality: QualityConfig = field(default_factory=QualityConfig)  # of the epsilon qualities

    def resolved(self) -> "MetricConfig":
        """The same with the implementations that `auto` stands for on this machine."""
        return MetricConfig(self.lines.resolved(), self.quality.resolved())


@dataclass(frozen=True)
class MetricTable:
    """The metrics of n grasps, and what says how far to trust them."""

    values: dict[str, Float[Array, "n"]]  # by name, in the order of their numbers
    extra: dict[str, Array]  # n each: bounds of qualities, flags, outcome of the nominal trial
    outcomes: Int[Array, "n t"]  # values of `Outcome`, of every trial
    cost: dict[str, float]  # s for all n grasps, by stage; `epsilon` is what the three share
    evidence: Evidence  # which kernels ran, and how well the three qualities are known

    def __len__(self) -> int:
        return len(self.outcomes)

    def __getitem__(self, name: str) -> Float[Array, "n"]:
        """The values of one metric.

        Raises:
            MetricError: There is no metric of that name.
        """
        if name not in self.values:
            raise MetricError(f"no metric '{name}': there are {', '.join(self.values)}")
        return self.values[name]

    def to_pandas(self) -> "pd.DataFrame":
        """A row per grasp: the 36 metrics, then the further columns."""
        import pandas as pd

        return pd.DataFrame({**self.values, **self.extra})


@dataclass(frozen=True)
class _Pair:
    """The grasp that two pads' mean contact points make; NaN without contact on both."""

    middle: Float[Array, "n 3"]  # m
    axis: Float[Array, "n 3"]  # m, from pad 0 to pad 1, not normalised

    @property
    def width(self) -> Float[Array, "n"]:
        width: Array = np.linalg.norm(self.axis, axis=1)
        return width


def compute_metrics(
    scene: Scene,
    grasps: PlanarGrasp,
    trials: TrialResults,
    *,
    config: MetricConfig | None = None,
) -> MetricTable:
    """All 36 metrics of n grasps.

    Args:
        scene: The object at rest, under the physics that contacts have.
        grasps: n grasps of that scene.
        trials: Their trials, which also say with which gripper.
        config: Tolerances, lines.

    Raises:
        MetricError: The trials are not those of these grasps.
    """
    if not np.array_equal(grasps.grasp_id, trials.grasp_id):
        raise MetricError(
            f"{len(grasps)} grasps but the trials of {len(trials)}, or in another order: pass the "
            "trials of these grasps"
        )
    config = (MetricConfig() if config is None else config).resolved()
    gripper = trials.gripper
    clock = _Clock()
    values: dict[str, Array] = {}
    extra: dict[str, Array] = {}
    obj = scene.object

    with clock.stage("object"):
        values |= _object_metrics(obj, len(grasps))
    with clock.stage("grasp"):
        center = scene.to_object(grasps.center)
        values["g_dis"] = np.linalg.norm(center, axis=1)
        values["g_coll"] = collides(scene, grasps, gripper=gripper).astype(float)
    with clock.stage("contact"):
        analytical = closing_contacts(scene, grasps, gripper=gripper, config=config.lines)
        pair_d = _pair(analytical.pads)
        values |= _analytical_metrics(pair_d, center, scene.direction_to_object(grasps.axis))
    with clock.stage("trial"):
        pair_s = _pair(trials.contacts)
        values |= _simulative_metrics(pair_s, obj, grasps, trials)
        values |= motion_metrics(trials)
        values |= outcome_metrics(trials)
        values["g_offset_l"] = np.linalg.norm(pair_s.middle - pair_d.middle, axis=1)
        values["g_offset_a"] = _axes_angle(pair_s.axis, pair_d.axis)
    quality = config.quality
    sets = {
        "g_quality": PadSet(analytical.center, quality.rtol_pair),
        "real_d_quality": PadSet(analytical.pads, quality.rtol_patch),
        "real_s_quality": PadSet(trials.contacts, quality.rtol_patch),
    }
    with clock.stage("epsilon"):
        audited = audit_sample(scene, grasps.grasp_id, share=quality.audit)
        qualities = pad_qualities(sets, scene, audited=audited, config=quality)
    clock.attribute("audit", qualities.audit_seconds, of="epsilon")
    for name, found in qualities.by_name.items():
        values[name] = found.upper
        extra |= {f"{name}_lower": found.lower, f"{name}_upper": found.upper}
        clock.attribute(f"epsilon/{name}", found.seconds, of="epsilon")

    for name in METRIC_NAMES:
        if name.endswith("_norm"):
            values[name] = values[name.removesuffix("_norm")] / values["bound_l"]
    extra["force_is_lower_bound"] = trials.push_force_is_lower_bound
    extra["valid_trials"] = (~Outcome.is_failure(trials.outcome)).sum(axis=1)
    extra["outcome"] = np.array([Outcome(o).label for o in trials.outcome[:, 0]], dtype=object)
    return MetricTable(
        values={name: values[name] for name in METRIC_NAMES},
        extra=extra,
        outcomes=trials.outcome,
        cost=dict(clock.seconds),
        evidence=Evidence(
            kernels={
                "trials": trials.engine,
                "closing_lines": on_device(analytical.implementation),
                "pair_epsilon": on_device(config.quality.implementation),
            },
            qualities={name: found.tally for name, found in qualities.by_name.items()},
        ),
    )


class _Clock:
    """Adds up processor seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.process_time()
        yield
        self.seconds[name] += time.process_time() - start

    def attribute(self, name: str, seconds: float, *, of: str) -> None:
        """Count `seconds` of another stage under a name of their own."""
        self.seconds[name] += seconds
        self.seconds[of] -= seconds


def _object_metrics(obj: ObjectModel, n: int) -> dict[str, Array]:
    longest, middle, shortest = obj.box.extents
    return {
        "bound_x": np.full(n, longest),
        "bound_y": np.full(n, middle),
        "bound_l": np.full(n, shortest),
        "bound_r": np.full(n, longest / shortest),
    }


def _analytical_metrics(
    pair: _Pair, center: Float[Array, "n 3"], axis: Float[Array, "n 3"]
) -> dict[str, Array]:
    return {
        "real_d_width": pair.width,
        "real_d_dis": np.linalg.norm(pair.middle, axis=1),
        "real_d_offset_l": np.linalg.norm(pair.middle - center, axis=1),
        "real_d_offset_a": _axes_angle(pair.axis, axis),
    }


def _simulative_metrics(
    pair: _Pair, obj: ObjectModel, grasps: PlanarGrasp, trials: TrialResults
) -> dict[str, Array]:
    """What the contacts at the end of closing say, in the object's frame."""
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


def motion_metrics(trials: TrialResults) -> dict[str, Array]:
    """How the object moved; the gripper does not turn, so neither does its frame."""
    position, turn = trials.object_position, trials.object_quaternion
    shift = position[:, Snapshot.CLOSED] - position[:, Snapshot.CLOSING]
    return {
        "clo_ori_comfort": rotation_angle(turn[:, Snapshot.CLOSING], turn[:, Snapshot.CLOSED]),
        "lif_ori_stability": rotation_angle(turn[:, Snapshot.CLOSED], turn[:, Snapshot.HELD]),
        "moved": np.linalg.norm(shift, axis=1),
    }


def outcome_metrics(trials: TrialResults) -> dict[str, Array]:
    """Shares over the trials that say something: one that diverged does not."""
    valid = ~Outcome.is_failure(trials.outcome)
    count = valid.sum(axis=1)
    successes = (trials.outcome == Outcome.SUCCESS).sum(axis=1)
    hits = (trials.collision & valid).any(axis=1)
    return {
        "sim_success": np.where(count > 0, successes / np.maximum(count, 1), np.nan),
        "sim_coll": np.where(count > 0, hits.astype(float), np.nan),
        "force": trials.push_force,
    }


def _pair(contacts: PadContacts) -> _Pair:
    means = contacts.means
    return _Pair(0.5 * (means[:, 0] + means[:, 1]), means[:, 1] - means[:, 0])


def _axes_angle(a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Angles between axes, rad; NaN where one has no length, so no direction."""
    exists: Bool[Array, n] = (np.linalg.norm(a, axis=1) > 0) & (np.linalg.norm(b, axis=1) > 0)
    return np.where(exists, axis_angle_between(a, b), np.nan)
