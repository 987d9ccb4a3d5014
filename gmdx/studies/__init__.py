"""Figures about the pipeline itself: its speed, its simulator's bias, what its labels depend on.

The studies' entries are here; each is imported from its module when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gmdx.studies.bias.figures import figures as bias_figures
    from gmdx.studies.bias.result import BiasConfig, BiasStudy
    from gmdx.studies.bias.study import bias_study
    from gmdx.studies.engines.truth import truth_table
    from gmdx.studies.sensitivity.result import SensitivityStudy
    from gmdx.studies.sensitivity.study import SensitivityConfig, sensitivity_study

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

_HOME = {
    "BiasConfig": ("bias.result", "BiasConfig"),
    "BiasStudy": ("bias.result", "BiasStudy"),
    "SensitivityConfig": ("sensitivity.study", "SensitivityConfig"),
    "SensitivityStudy": ("sensitivity.result", "SensitivityStudy"),
    "bias_figures": ("bias.figures", "figures"),
    "bias_study": ("bias.study", "bias_study"),
    "sensitivity_study": ("sensitivity.study", "sensitivity_study"),
    "truth_table": ("engines.truth", "truth_table"),
}


def __getattr__(name: str) -> Any:
    """A study's entry, from the module that defines it."""
    if name not in _HOME:
        raise AttributeError(f"module 'gmdx.studies' has no attribute {name!r}")
    module, attribute = _HOME[name]
    return getattr(import_module(f"gmdx.studies.{module}"), attribute)
