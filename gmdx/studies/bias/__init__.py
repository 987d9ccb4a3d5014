"""How much labels depend on the engine: a dataset's grasps in another one, and a noise floor.

`bias_study` runs it; `bias_figures` draws it, `summary` puts it into a table.
"""

from gmdx.studies.bias.figures import bias_figures
from gmdx.studies.bias.result import BiasConfig, BiasStudy
from gmdx.studies.bias.study import bias_study
from gmdx.studies.bias.words import summary, summary_head

__all__ = [
    "BiasConfig",
    "BiasStudy",
    "bias_figures",
    "bias_study",
    "summary",
    "summary_head",
]
