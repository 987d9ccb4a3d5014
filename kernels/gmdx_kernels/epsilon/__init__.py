"""Epsilon quality of two-contact grasps in bulk, in NumPy and in JAX.

Both run one source, written against the array library they share, and are judged by closed
forms and by the certified routine for single grasps. NumPy starts at once and is the one to
use for up to some 100,000 grasps on a CPU; JAX first compiles for some 20 s, then takes about
half the time a value (three quarters with its proof); on accelerators it was not measured. On one
machine either gives a grasp the same bits in any batch; NumPy's values and directions are made by
additions, multiplications, divisions and square roots in a fixed order (but for pairs that are
flat or that torsion alone closes, where LAPACK has a say), so that they should not depend on
the machine either.
"""

from gmdx_kernels.epsilon.api import IMPLEMENTATIONS, pair_epsilon
from gmdx_kernels.epsilon.pairs import PairEpsilon

__all__ = ["IMPLEMENTATIONS", "PairEpsilon", "pair_epsilon"]
