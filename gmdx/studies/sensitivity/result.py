"""What a sensitivity study found: its runs, its indices, and both as JSON."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.studies.sensitivity.indices import Design, Indices, indices
from gmdx.studies.sensitivity.parameters import SEED, Parameter
from gmdx.studies.sensitivity.runs import BASELINE, COUNTS, OUTPUTS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

ALL = "all objects"


@dataclass(frozen=True)
class SensitivityStudy:
    """A finished study."""

    root: Path
    method: str
    parameters: tuple[Parameter, ...]
    design: Design
    runs: "pd.DataFrame"  # one row a run of an object
    indices: Mapping[str, Mapping[str, Indices]]  # by output, then by object id and `ALL`
    figures: Mapping[str, "Figure"]  # by name
    failures: Mapping[str, str]  # objects left out, with the reason


def by_object(design: Design, runs: "pd.DataFrame", output: str, seed: int) -> dict[str, Indices]:
    """Indices of one output for all objects together (`ALL`), then for each.

    Args:
        design: Of the study.
        runs: Of the study, by object and run.
        output: Name of the output.
        seed: Of the bootstrap.
    """
    varied = runs[runs.block != BASELINE]
    own = {str(name): rows[output].to_numpy(float) for name, rows in varied.groupby("object_id")}
    together = {ALL: pooled(design, np.stack(list(own.values())))}
    return {name: indices(design, found, seed=seed) for name, found in {**together, **own}.items()}


def pooled(design: Design, values: Float[Array, "o r"]) -> Float[Array, "r"]:
    """The mean over objects at each place, over the same objects throughout a block.

    An object without a value somewhere in a block is left out of that block: a mean over other
    objects at each place would show which objects have a value, not what the parameters do.
    Sobol's indices compare blocks with each other, so there a block needs all objects.

    Returns:
        NaN where a block has no object left.
    """
    mean = np.full(values.shape[1], np.nan)
    for block in range(design.blocks):
        rows = design.block == block
        whole = ~np.isnan(values[:, rows]).any(axis=1)
        if whole.all() or (whole.any() and design.method != "sobol"):
            mean[rows] = values[np.ix_(whole, rows)].mean(axis=0)
    return mean


def summary(study: SensitivityStudy) -> dict[str, Any]:
    """What `sensitivity.json` holds: parameters, baseline, counts, indices."""
    runs = study.runs
    baseline = runs[runs.block == BASELINE].set_index("object_id")
    outputs = {}
    for output in OUTPUTS:
        found = study.indices[output.name]
        outputs[output.name] = {
            **asdict(output),
            "baseline": {key: float(value) for key, value in baseline[output.name].items()},
            "runs_without_value": int(runs[output.name].isna().sum()),
            "object_blocks_left_out": sum(
                value.blocks_left_out for key, value in found.items() if key != ALL
            ),
            "indices": {key: _record(value) for key, value in found.items()},
        }
    return {
        "method": study.method,
        "objects": sorted(baseline.index),
        "failures": dict(study.failures),
        "runs": len(runs),
        "runs_per_object": len(study.design) + 1,
        "counts": {name: int(runs[name].sum()) for name in COUNTS},
        "blocks": study.design.blocks,
        "parameters": [
            p.record() | {"default": float(baseline[p.name].iloc[0]), "reason": p.reason}
            for p in study.parameters
        ],
        "outputs": outputs,
    }


def _record(found: Indices) -> dict[str, Any]:
    above = found.above(SEED)
    return {
        "blocks": found.blocks,
        "blocks_left_out": found.blocks_left_out,
        "constant": found.constant,
        "parameters": {
            name: {
                "main": float(found.main[k]),
                "main_half": float(found.main_half[k]),
                "total": float(found.total[k]),
                "total_half": float(found.total_half[k]),
                "spread": float(found.spread[k]),
                "above_noise": above[k],
            }
            for k, name in enumerate(found.names)
        },
    }
