"""Engines compared: how fast they are, whether they agree trial by trial, and with closed forms.

`trial_figures` measures speed, `parity_figures` agreement with C MuJoCo, and `truth_table` holds
engines to forces that are known.
"""

from gmdx.studies.engines.machine import Machine
from gmdx.studies.engines.parity_result import EngineParity, MetricParity, ParityFigures
from gmdx.studies.engines.parity_runs import parity_figures
from gmdx.studies.engines.runs import (
    RunFailure,
    choose_all,
    refuse_idle_sizes,
    refuse_less_than_one,
)
from gmdx.studies.engines.speed import TrialFigures, TrialSpeed, trial_figures
from gmdx.studies.engines.truth import TruthRow, truth_table

__all__ = [
    "EngineParity",
    "Machine",
    "MetricParity",
    "ParityFigures",
    "RunFailure",
    "TrialFigures",
    "TrialSpeed",
    "TruthRow",
    "choose_all",
    "parity_figures",
    "refuse_idle_sizes",
    "refuse_less_than_one",
    "trial_figures",
    "truth_table",
]
