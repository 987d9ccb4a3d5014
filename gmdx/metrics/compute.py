"""The 36 metrics of some grasps, stage by stage: from the cheap ones to those that need trials.

A cascade computes the stages that it needs to decide, and the next ones for the grasps that are
left; what was not computed is not in the table, and NaN is what does not exist for a grasp.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import MetricError
from gmdx.grasps.collide import collides
from gmdx.grasps.contact import ClosingContacts, LineConfig, closing_contacts
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.machine.clock import Clock, added
from gmdx.machine.devices import on_device
from gmdx.metrics.formulas import (
    analytical_metrics,
    comparative_metrics,
    contact_pair,
    motion_metrics,
    normalised,
    object_metrics,
    outcome_columns,
    outcome_metrics,
    simulative_metrics,
)
from gmdx.metrics.quality import (
    Evidence,
    PadSet,
    QualityConfig,
    Tally,
    audit_sample,
    pad_qualities,
)
from gmdx.metrics.table import (
    METRIC_NAMES,
    METRICS,
    STAGE_NEEDS,
    STAGES,
    TRIAL_STAGES,
    Stage,
)
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.scene import Scene
from gmdx.trials.results import TrialResults

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class MetricConfig:
    """How the metrics are computed."""

    lines: LineConfig = field(default_factory=LineConfig)  # of the analysis; sampling asks it too
    quality: QualityConfig = field(default_factory=QualityConfig)  # of the epsilon qualities

    def resolved(self) -> "MetricConfig":
        """The same with the implementation that `auto` stands for."""
        return replace(self, quality=self.quality.resolved())


@dataclass(frozen=True)
class MetricTable:
    """Metrics of n grasps, and what says how far to trust them."""

    grasp_id: Int[Array, "n"]
    stages: tuple[Stage, ...]  # that were computed
    values: dict[str, Float[Array, "n"]]  # by name, in the order of their numbers
    extra: dict[str, Array]  # n each: bounds of qualities, flags, outcome of the nominal trial
    outcomes: Int[Array, "n t"] | None  # values of `Outcome`, of every trial; None without trials
    contacts: ClosingContacts | None  # the analytical ones; None before stage `contact`
    cost: dict[str, float]  # processor seconds by stage; `epsilon` is what all qualities share
    evidence: Evidence  # which kernels ran, and how well the qualities are known

    def __len__(self) -> int:
        return len(self.grasp_id)

    def __getitem__(self, name: str) -> Float[Array, "n"]:
        """The values of one metric.

        Raises:
            MetricError: There is no metric of that name, or it was not computed.
        """
        if name in self.values:
            return self.values[name]
        if name not in METRIC_NAMES:
            raise MetricError(f"no metric '{name}': there are {', '.join(METRIC_NAMES)}")
        stage = next(metric.stage for metric in METRICS if metric.name == name)
        raise MetricError(
            f"metric '{name}' was not computed: it is of the stage {stage!r}, and this table has "
            f"{', '.join(self.stages)}"
        )

    def take(self, rows: Int[Array, "m"]) -> "MetricTable":
        """The same metrics of some of the grasps, to go on with; the cost stays with this one."""
        return replace(
            self,
            grasp_id=self.grasp_id[rows],
            values={name: value[rows] for name, value in self.values.items()},
            extra={name: value[rows] for name, value in self.extra.items()},
            outcomes=None if self.outcomes is None else self.outcomes[rows],
            contacts=None if self.contacts is None else self.contacts[rows],
            cost={},
            evidence=Evidence(),
        )

    def to_pandas(self) -> "pd.DataFrame":
        """A row per grasp: the metrics, then the further columns."""
        import pandas as pd

        return pd.DataFrame({**self.values, **self.extra})


def compute_metrics(
    scene: Scene,
    grasps: PlanarGrasp,
    trials: TrialResults | None = None,
    *,
    stages: Sequence[str] | None = None,
    known: MetricTable | None = None,
    gripper: Gripper | None = None,
    config: MetricConfig | None = None,
) -> MetricTable:
    """The metrics of n grasps: all 36, or those of some stages.

    Args:
        scene: The object at rest, under the physics that contacts have.
        grasps: n grasps of that scene.
        trials: Their trials; without them there are the stages before trials only.
        stages: Of object, grasp, contact, epsilon, trial and trial_epsilon; what they rest on is
            computed with them. By default all that there is input for.
        known: A table of these grasps: its stages are taken over, and not computed again.
        gripper: What grasps, where no trials say so; the default one if not given.
        config: Tolerances, lines.

    Raises:
        MetricError: A stage is unknown, or needs trials and there are none; nothing is asked for
            and nothing known; or the trials, or what is known, are not of these grasps.
    """
    done = () if known is None else known.stages
    todo = _todo(stages, done, trials)
    _check(grasps, trials, known)
    config = (MetricConfig() if config is None else config).resolved()
    if trials is not None:
        gripper = trials.gripper
    elif gripper is None:
        gripper = load_gripper()
    obj, quality = scene.object, config.quality
    clock = Clock()
    values: dict[str, Array] = {}
    extra: dict[str, Array] = {}
    kernels: dict[str, str] = {}
    analytical = None if known is None else known.contacts
    outcomes = None if known is None else known.outcomes

    if "object" in todo:
        with clock.stage("object"):
            values |= object_metrics(obj, len(grasps))
    if "grasp" in todo:
        with clock.stage("grasp"):
            values["g_dis"] = np.linalg.norm(scene.to_object(grasps.center), axis=1)
            values["g_coll"] = collides(scene, grasps, gripper=gripper).astype(float)
    if "contact" in todo:
        with clock.stage("contact"):
            analytical = closing_contacts(scene, grasps, gripper=gripper, config=config.lines)
            values |= analytical_metrics(contact_pair(analytical.pads), scene, grasps)
        kernels["closing_lines"] = "numpy"
    sets: dict[str, PadSet] = {}
    if analytical is not None and "epsilon" in todo:
        sets["g_quality"] = PadSet(analytical.center, quality.rtol_pair)
        sets["real_d_quality"] = PadSet(analytical.pads, quality.rtol_patch)
    if trials is not None:
        outcomes = trials.outcome
    if trials is not None and analytical is not None and "trial" in todo:
        with clock.stage("trial"):
            simulative = contact_pair(trials.contacts)
            values |= simulative_metrics(simulative, obj, grasps, trials)
            values |= motion_metrics(trials)
            values |= outcome_metrics(trials)
            values |= comparative_metrics(simulative, contact_pair(analytical.pads))
        extra |= outcome_columns(trials)
        kernels["trials"] = trials.engine
    if trials is not None and "trial_epsilon" in todo:
        sets["real_s_quality"] = PadSet(trials.contacts, quality.rtol_patch)
    tallies: dict[str, Tally] = {}
    cost: dict[str, float] = {}
    if sets:
        with clock.stage("epsilon"):  # together, as pairs of contacts are valued in bulk
            audited = audit_sample(scene, grasps.grasp_id, share=quality.audit)
            found = pad_qualities(sets, scene, audited=audited, config=quality)
        for name, one in found.by_name.items():
            values[name] = one.upper
            extra |= {f"{name}_lower": one.lower, f"{name}_upper": one.upper}
            tallies[name] = one.tally
            cost[f"epsilon/{name}"] = one.seconds
        cost["audit"] = found.audit_seconds
        kernels["pair_epsilon"] = on_device(quality.implementation)
    cost = _cost(clock, cost)

    if known is not None:
        values, extra, cost = known.values | values, known.extra | extra, added(known.cost, cost)
    values |= normalised(values, values["bound_l"])
    return MetricTable(
        grasp_id=grasps.grasp_id,
        stages=tuple(stage for stage in STAGES if stage in (*done, *todo)),
        values={name: values[name] for name in METRIC_NAMES if name in values},
        extra=extra,
        outcomes=outcomes,
        contacts=analytical,
        cost=cost,
        evidence=(Evidence() if known is None else known.evidence) + Evidence(kernels, tallies),
    )


def _todo(
    stages: Sequence[str] | None, done: Sequence[Stage], trials: TrialResults | None
) -> set[Stage]:
    """The stages to compute: those asked for with what they rest on, less what is known.

    Raises:
        MetricError: One is unknown, or needs trials; or there is none, and none is known.
    """
    if isinstance(stages, str):
        raise MetricError(f"stages are a list of names, as [{stages!r}], and not one text")
    possible = [name for name in STAGES if trials is not None or name not in TRIAL_STAGES]
    unknown = [name for name in (() if stages is None else stages) if name not in STAGES]
    if unknown:
        raise MetricError(f"no stage {unknown[0]!r}: there are {', '.join(STAGES)}")
    asked = [name for name in STAGES if name in (possible if stages is None else stages)]
    todo: set[Stage] = set()
    while asked:
        stage = asked.pop()
        if stage not in done and stage not in todo:
            todo.add(stage)
            asked += STAGE_NEEDS[stage]
    missing = [name for name in STAGES if name in todo and name not in possible]
    if missing:
        raise MetricError(f"the stage {missing[0]!r} needs trials: pass those of these grasps")
    if not todo and not done:
        raise MetricError(f"no stage is asked for: name some of {', '.join(STAGES)}")
    return todo


def _check(grasps: PlanarGrasp, trials: TrialResults | None, known: MetricTable | None) -> None:
    """Refuse what belongs to other grasps."""
    if trials is not None and not np.array_equal(grasps.grasp_id, trials.grasp_id):
        raise MetricError(
            f"{len(grasps)} grasps but the trials of {len(trials)}, or in another order: pass the "
            "trials of these grasps"
        )
    if known is not None and not np.array_equal(grasps.grasp_id, known.grasp_id):
        raise MetricError(
            f"{len(grasps)} grasps but known metrics of {len(known)}, or in another order: take "
            "the rows of these grasps from that table"
        )


def _cost(clock: Clock, attributed: Mapping[str, float]) -> dict[str, float]:
    """Processor seconds by stage; what is attributed to one quality is no more of `epsilon`."""
    seconds = dict(clock.seconds.processor)
    if attributed:
        seconds["epsilon"] -= sum(attributed.values())
    return {**seconds, **attributed}
