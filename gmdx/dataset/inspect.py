"""What a dataset holds, at a glance: read object by object, shown as tables."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from rich.markup import escape
from rich.table import Table

from gmdx.arrays import Array, Float
from gmdx.dataset.labels import dataset_digest, misfit_of
from gmdx.dataset.read import Dataset
from gmdx.dataset.schema import OUTCOMES
from gmdx.errors import Failure
from gmdx.metrics.quality import Evidence, Tally
from gmdx.metrics.table import METRIC_NAMES
from gmdx.trials.outcome import Outcome

_READ = ("scene_id", "outcomes", *METRIC_NAMES)


@dataclass(frozen=True)
class ObjectLine:
    """One object's counts."""

    object_id: str
    scenes: int
    grasps: int
    success: float  # mean of sim_success; NaN without grasps
    unsafe: float  # share of grasps whose open gripper collides
    held_force: float  # N, median push-out force of the lifted ones; NaN if none was
    cpu_seconds: float  # that producing it took


@dataclass(frozen=True)
class LabelLine:
    """One label table."""

    name: str
    labelled: int  # grasps
    positive: int  # of these
    made_by: str
    misfit: str | None  # why it is not for the dataset as it is now


@dataclass(frozen=True)
class Overview:
    """A dataset in figures."""

    root: str
    info: Mapping[str, Any]  # dataset.json
    objects: tuple[ObjectLine, ...]
    outcomes: Mapping[str, int]  # trials, by name of their outcome
    missing: Mapping[str, int]  # grasps without a value, by metric; those with any
    failures: tuple[Failure, ...]
    seconds: Mapping[str, float]  # processor seconds by stage, over all objects
    evidence: Evidence  # how well the epsilon qualities are known, over all objects
    labels: tuple[LabelLine, ...] = ()

    @property
    def grasps(self) -> int:
        """Number of grasps."""
        return sum(line.grasps for line in self.objects)


def overview(dataset: Dataset) -> Overview:
    """Read a dataset once, object by object.

    Raises:
        DatasetError: A file is damaged.
    """
    lines: list[ObjectLine] = []
    outcomes: Counter[str] = Counter()
    missing: Counter[str] = Counter()
    seconds: Counter[str] = Counter()
    evidence = Evidence()
    for object_id in dataset.objects:
        rows = dataset.grasps(object_id, columns=_READ)
        cost = dataset.cost(object_id)
        seconds.update(cost["cpu_seconds"])
        evidence += dataset.evidence(object_id)
        counted = pc.value_counts(pc.list_flatten(rows["outcomes"]))
        outcomes.update({entry["values"]: entry["counts"] for entry in counted.to_pylist()})
        values = {name: rows[name].to_numpy() for name in METRIC_NAMES}
        missing.update({name: int(np.isnan(column).sum()) for name, column in values.items()})
        lines.append(_line(object_id, rows, values, sum(cost["cpu_seconds"].values())))
    return Overview(
        root=str(dataset.root),
        info=dataset.info,
        objects=tuple(lines),
        outcomes=outcomes,
        missing={name: missing[name] for name in METRIC_NAMES if missing[name]},
        failures=tuple(dataset.failures),
        seconds=seconds,
        evidence=evidence,
        labels=tuple(_label_lines(dataset)),
    )


def _label_lines(dataset: Dataset) -> Iterator[LabelLine]:
    names = dataset.label_tables
    now = dataset_digest(dataset.root, dataset.info) if names else None
    for name in names:
        about = dataset.describe_labels(name)
        misfit = None if now is None else misfit_of(about, now)
        yield LabelLine(name, about["labelled"], about["positive"], about["made_by"], misfit)


def _line(
    object_id: str, rows: pa.Table, values: Mapping[str, Array], cpu_seconds: float
) -> ObjectLine:
    lifted = pc.equal(pc.list_element(rows["outcomes"], 0), Outcome.SUCCESS.label).to_numpy()
    force = values["force"][lifted & np.isfinite(values["force"])]
    return ObjectLine(
        object_id=object_id,
        scenes=pc.count_distinct(rows["scene_id"]).as_py(),
        grasps=rows.num_rows,
        success=_mean(values["sim_success"]),
        unsafe=_mean(values["g_coll"]),
        held_force=float(np.median(force)) if len(force) else float("nan"),
        cpu_seconds=cpu_seconds,
    )


def _mean(values: Float[Array, "n"]) -> float:
    """Mean of the values that exist."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def tables(view: Overview) -> Iterator[Table]:
    """An overview as tables for a terminal."""
    yield _summary(view)
    yield _objects(view.objects)
    if view.outcomes:
        yield _shares("Outcomes of trials", {o: view.outcomes.get(o, 0) for o in OUTCOMES}, "")
    if view.missing:
        yield _missing(view)
    if view.evidence.qualities:
        yield _qualities(view.evidence.qualities)
    if view.labels:
        yield _labels(view)
    if view.seconds:
        yield _shares("Processor seconds", view.seconds, ".1f")
    if view.failures:
        yield _failures(view.failures)


def _summary(view: Overview) -> Table:
    table = Table(show_header=False, title=view.root, title_justify="left")
    info = view.info
    table.add_row("status", str(info["status"]))
    table.add_row("objects", str(len(view.objects)))
    table.add_row("scenes", str(sum(line.scenes for line in view.objects)))
    table.add_row("grasps", str(view.grasps))
    table.add_row("failures", str(len(view.failures)))
    table.add_row("gripper", str(info["gripper"]["name"]))
    table.add_row("engine", str(info["engine"]))
    table.add_row("seed", str(info["seed"]))
    for kernel, name in view.evidence.kernels.items():
        table.add_row(kernel, name)
    return table


def _objects(lines: Iterable[ObjectLine]) -> Table:
    table = Table(title="Objects", title_justify="left")
    table.add_column("object", overflow="fold", min_width=16)
    for name in ("scenes", "grasps", "success", "collides", "median force N", "CPU s", "s/grasp"):
        table.add_column(name, justify="right")
    for line in lines:
        each = line.cpu_seconds / line.grasps if line.grasps else float("nan")
        table.add_row(
            line.object_id,
            str(line.scenes),
            str(line.grasps),
            _percent(line.success),
            _percent(line.unsafe),
            _number(line.held_force, ".1f"),
            _number(line.cpu_seconds, ".1f"),
            _number(each, ".3f"),
        )
    return table


def _shares(title: str, amounts: Mapping[str, int] | Mapping[str, float], precision: str) -> Table:
    """A histogram with bars."""
    table = Table("", title=title, title_justify="left")
    table.add_column("", justify="right")
    table.add_column("share", justify="right")
    table.add_column("")
    total = sum(amounts.values())
    for name, amount in amounts.items():
        share = amount / total if total else 0.0
        table.add_row(name, format(amount, precision), _percent(share), "█" * round(30 * share))
    return table


def _missing(view: Overview) -> Table:
    table = Table("metric", title="Grasps without a value (NaN)", title_justify="left")
    table.add_column("grasps", justify="right")
    table.add_column("share", justify="right")
    for name, count in view.missing.items():
        table.add_row(name, str(count), _percent(count / view.grasps))
    return table


def _qualities(tallies: Mapping[str, Tally]) -> Table:
    """How far the bounds of the qualities are apart, and what the audit found."""
    table = Table("epsilon quality", title="Certified qualities", title_justify="left")
    for name in ("values", "closure", "certified", "worst gap", "audited", "worst difference"):
        table.add_column(name, justify="right")
    for name, tally in tallies.items():
        table.add_row(
            name,
            str(tally.values),
            _percent(tally.closed / tally.values if tally.values else float("nan")),
            str(tally.certified),
            _number(tally.worst_gap, ".1e"),
            str(tally.audited),
            _number(tally.worst_audit if tally.audited else float("nan"), ".1e"),
        )
    return table


def _labels(view: Overview) -> Table:
    table = Table("labels", title="Label tables", title_justify="left")
    for name in ("grasps", "of all", "positive"):
        table.add_column(name, justify="right")
    table.add_column("made by", overflow="fold")
    table.add_column("fits the dataset", overflow="fold")
    for line in view.labels:
        table.add_row(
            line.name,
            str(line.labelled),
            _percent(line.labelled / view.grasps if view.grasps else float("nan")),
            _percent(line.positive / line.labelled if line.labelled else float("nan")),
            escape(line.made_by),
            "yes" if line.misfit is None else f"no: {line.misfit}",
        )
    return table


def _failures(failures: Iterable[Failure]) -> Table:
    table = Table("object", "scene", "stage", "error", title="Failures", title_justify="left")
    for failure in failures:
        scene = "all" if failure.scene_id is None else str(failure.scene_id)
        what = escape(f"{failure.error}: {failure.message}")
        table.add_row(failure.object_id, scene, failure.stage, what)
    return table


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.0f} %"


def _number(value: float, precision: str) -> str:
    return "-" if np.isnan(value) else format(value, precision)
