"""How much labels depend on the trials' parameters: by Morris, by Sobol, or one at a time.

`sensitivity_study` runs it; `summary` is its result as records, `table` the same for a terminal.
"""

from gmdx.studies.sensitivity.report import table
from gmdx.studies.sensitivity.result import SensitivityStudy, summary
from gmdx.studies.sensitivity.study import SensitivityConfig, sensitivity_study

__all__ = [
    "SensitivityConfig",
    "SensitivityStudy",
    "sensitivity_study",
    "summary",
    "table",
]
