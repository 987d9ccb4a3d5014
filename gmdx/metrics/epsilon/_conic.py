"""Conic programmes, by Clarabel."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
import scipy.sparse

from gmdx.arrays import Array, Float

_LOG = logging.getLogger("gmdx")
_MOST_ITERATIONS = 60  # about three times as many as any programme here takes
_REFINED = 1e-7  # accuracy that the solver reaches only by refining its linear solutions


@dataclass(frozen=True)
class ConicSolution:
    """What the solver ended with, whatever it thinks of it; NaN if it crashed."""

    x: Float[Array, "v"]
    z: Float[Array, "c"]  # multipliers of the constraints


def solve_conic(
    q: Float[Array, "v"],
    matrix: scipy.sparse.csc_matrix,
    b: Float[Array, "c"],
    cones: Sequence[Any],
    *,
    tol: float,
    feasibility: float,
    absolute: float = 0.0,
) -> ConicSolution:
    """Minimise q . x with b - matrix x in the product of `cones`.

    Nothing is made of the solver's status: whoever calls proves what the solution says.

    Args:
        q: Costs.
        matrix: Of the constraints.
        b: Their constants.
        cones: Of Clarabel, in the order of the rows.
        tol: Relative gap of the objective at which to stop.
        feasibility: Relative residual of the constraints at which to stop.
        absolute: Gap of the objective at which to stop as well.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False  # for sparse matrices: here all are full
    settings.max_iter = _MOST_ITERATIONS
    settings.tol_gap_rel = tol
    settings.tol_gap_abs = absolute
    settings.tol_feas = feasibility
    settings.iterative_refinement_enable = tol < _REFINED
    size = len(q)
    nothing = scipy.sparse.csc_matrix((size, size))
    try:
        found = clarabel.DefaultSolver(nothing, q, matrix, b, cones, settings).solve()
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # of Rust: no subclass of Exception
            raise
        _LOG.warning("Clarabel crashed and its bound is left out: %s", error)
        return ConicSolution(np.full(size, np.nan), np.full(len(b), np.nan))
    return ConicSolution(np.asarray(found.x), np.asarray(found.z))
