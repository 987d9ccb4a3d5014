"""Figures about the pipeline itself: its speed, its simulator's bias, what its labels depend on.

A folder a study. The studies' entries are here; each is imported from its study's door when it is
first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gmdx.studies.bias import BiasConfig, BiasStudy, bias_figures, bias_study
    from gmdx.studies.engines import truth_table
    from gmdx.studies.sensitivity import SensitivityConfig, SensitivityStudy, sensitivity_study

__all__ = [
    "BiasConfig",
    "BiasStudy",
    "SensitivityConfig",
    "SensitivityStudy",
    "bias_figures",
    "bias_study",
    "sensitivity_study",
    "truth_table",
]

_DOORS = {
    "gmdx.studies.bias": ("BiasConfig", "BiasStudy", "bias_figures", "bias_study"),
    "gmdx.studies.engines": ("truth_table",),
    "gmdx.studies.sensitivity": ("SensitivityConfig", "SensitivityStudy", "sensitivity_study"),
}
_HOME = {name: door for door, names in _DOORS.items() for name in names}


def __getattr__(name: str) -> Any:
    """A study's entry, from the door that offers it."""
    if name not in _HOME:
        raise AttributeError(f"module 'gmdx.studies' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
