"""Ways to the epsilon quality compared: how fast, and how far off.

`epsilon_figures` sets certified values beside the usual hulls of linearised cones, on random
contacts (`random_pairs`, `random_patches`); `patch_figures` shows what patches of contacts change.
"""

from gmdx.studies.epsilon.approximations import (
    HullEpsilon,
    linearised_epsilon,
    sampled_epsilon,
)
from gmdx.studies.epsilon.contacts import Contacts, random_pairs, random_patches
from gmdx.studies.epsilon.methods import (
    EpsilonFigures,
    EpsilonStudyConfig,
    MethodFigures,
    epsilon_figures,
)
from gmdx.studies.epsilon.patches import patch_figures

__all__ = [
    "Contacts",
    "EpsilonFigures",
    "EpsilonStudyConfig",
    "HullEpsilon",
    "MethodFigures",
    "epsilon_figures",
    "linearised_epsilon",
    "patch_figures",
    "random_pairs",
    "random_patches",
    "sampled_epsilon",
]
