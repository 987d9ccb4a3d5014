"""Epsilon quality: the largest load from whatever side that a grasp resists, with proved bounds.

`epsilon` values one set of contacts, `epsilon_batch` many pairs at once by an array kernel, and
`directional_strength` says how much of one given load a grasp bears. Below them are the contacts'
wrenches (`wrench`), the patches that fingers touch (`patch`), and the proof (`_certify` and what
it calls: bounds from below by a relaxation, from above by descent).
"""

from gmdx.metrics.epsilon._certify import NEAR_ZERO
from gmdx.metrics.epsilon.certified import Epsilon, check_effort, epsilon
from gmdx.metrics.epsilon.many import EpsilonBatch, epsilon_batch
from gmdx.metrics.epsilon.patch import essential_contacts, hull_corners
from gmdx.metrics.epsilon.strength import Strength, directional_strength, gravity_wrench
from gmdx.metrics.epsilon.wrench import WrenchCones, check_contacts, support, wrench_cones

__all__ = [
    "NEAR_ZERO",
    "Epsilon",
    "EpsilonBatch",
    "Strength",
    "WrenchCones",
    "check_contacts",
    "check_effort",
    "directional_strength",
    "epsilon",
    "epsilon_batch",
    "essential_contacts",
    "gravity_wrench",
    "hull_corners",
    "support",
    "wrench_cones",
]
