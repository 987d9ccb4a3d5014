"""What an object cost: seconds by stage, for `cost.json`."""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

from gmdx.machine.clock import Seconds, added
from gmdx.metrics.table import METRICS, STAGES
from gmdx.trials.results import TrialResults


def cost_record(
    seconds: Seconds,
    *,
    prepared: Mapping[str, float],
    trials: Sequence[TrialResults],
    metrics: Sequence[Mapping[str, float]],
) -> dict[str, Any]:
    """The content of `cost.json`.

    Args:
        seconds: By stage of the pipeline; a device's seconds stand for processor seconds.
        prepared: Processor seconds by step that preparing the object reported.
        trials: Of all scenes, with the seconds inside the engine's step.
        metrics: Processor seconds by stage of metric tables.
    """
    grasps = sum(map(len, trials))
    by_stage: Mapping[str, float] = reduce(added, metrics, dict[str, float]())
    return {
        "grasps": grasps,
        "wall_seconds": dict(seconds.wall),
        "cpu_seconds": dict(seconds.processor),
        "prepare_seconds": dict(prepared),
        "trials": {
            "steps": sum(found.steps for found in trials),
            "step_seconds": sum(found.step_seconds for found in trials),
            "seconds": sum(found.seconds for found in trials),
        },
        "metric_seconds": dict(by_stage),
        "seconds_per_grasp_and_metric": {
            name: cost / max(grasps, 1)
            for name, cost in _by_metric(by_stage, seconds.processor.get("trials", 0.0)).items()
        },
    }


def _by_metric(metrics: Mapping[str, float], trials: float) -> dict[str, float]:
    """Processor seconds that one metric of all grasps needs, with all that it rests on.

    Metrics of one stage share its cost: asked for together, they cost it once.
    """
    stages = {name: metrics.get(name, 0.0) for name in STAGES}
    stages["trial"] += trials
    seconds = {}
    for metric in METRICS:
        if metric.is_quality:
            contacts = stages["contact"] if metric.kind == "priori" else stages["trial"]
            total = contacts + metrics.get(f"epsilon/{metric.name}", 0.0)
        else:
            total = stages[metric.stage]
            if metric.kind == "comparative":
                total += stages["contact"]
        seconds[metric.name] = total
    return seconds
