"""Forces of contacts with elliptic friction cones, and of limits, by Newton's method in one world.

The cost is MuJoCo's (documentation, "Computation", constraint solver), and so are its zones: a
contact is open, sticks, or slides on its cone. The Hessian is summed up contact by contact, in
blocks of four rows: one matrix over all rows would cost a hundred times as much.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

_TINY = 1e-15
_LINE_ENOUGH = 1e-4  # share of the slope at the start of a line search that may be left


class Rows(NamedTuple):
    """Constraints of one row: an equality where `always`, else a push in one direction only."""

    jacobian: Any  # (r v)
    stiffness: Any  # (r)
    target: Any  # (r)
    always: Any  # (r) bool


class Cones(NamedTuple):
    """Contacts: normal, two tangents, torsion. All zero where there is none."""

    jacobian: Any  # (c 4 v)
    stiffness: Any  # (c 4)
    target: Any  # (c 4)
    scale: Any  # (c 4) mu of the regularised cone, then the coefficients of friction


class Solution(NamedTuple):
    """What the constraints do."""

    acceleration: Any  # (v)
    force: Any  # (v) generalised
    contact_force: Any  # (c 4)
    iterations: Any


class _Problem(NamedTuple):
    inertia: Any  # (v v)
    free: Any  # (v) acceleration without constraints
    rows: Rows
    cones: Cones


class _Point(NamedTuple):
    acceleration: Any
    row_error: Any  # (r)
    cone_error: Any  # (c 4)
    cost: Any
    gradient: Any  # (v)
    search: Any  # (v) Newton's direction


def solve(
    inertia: Array,
    free: Array,
    rows: Rows,
    cones: Cones,
    start: Array,
    *,
    scale: Array,
    tolerance: Array,
    iterations: int,
    line_iterations: int,
) -> Solution:
    """The acceleration of least cost, starting from `start` or from `free`, whichever is better.

    Args:
        inertia: (v v) kg, kg m^2.
        free: (v) acceleration without constraints.
        rows: Equality and limits.
        cones: Contacts.
        start: (v) a guess.
        scale: Cost and gradient are multiplied by it before they are compared with `tolerance`.
        tolerance: Less improvement, or a smaller gradient, ends the search.
        iterations: At most.
        line_iterations: At most, in each line search.
    """
    problem = _Problem(inertia, free, rows, cones)
    better = _cost(problem, start) < _cost(problem, free)
    point = _at(problem, jnp.where(better, start, free))

    def go_on(state: tuple[_Point, Array, Array]) -> Array:
        _, count, done = state
        return ~done & (count < iterations)

    def improve(state: tuple[_Point, Array, Array]) -> tuple[_Point, Array, Array]:
        point, count, _ = state
        step = _line_search(problem, point, line_iterations)
        found = _at(problem, point.acceleration + step * point.search)
        better = scale * (point.cost - found.cost) >= tolerance  # not where it is not a number
        return found, count + 1, ~(better & (scale * _norm(found.gradient) >= tolerance))

    begin = (point, jnp.zeros((), jnp.int32), scale * _norm(point.gradient) < tolerance)
    point, count, _ = jax.lax.while_loop(go_on, improve, begin)
    row_force = _row_force(rows, point.row_error)
    contact_force, _, _ = _cone_force(cones, point.cone_error)
    force = _generalised(problem, row_force, contact_force)
    return Solution(point.acceleration, force, contact_force, count)


def solve_positive(matrix: Array, right: Array) -> Array:
    """Solve a small symmetric positive system by Cholesky's factors.

    Written out over columns, so that the order of sums does not depend on the batch.
    """
    size = matrix.shape[0]
    columns = []
    rest = matrix
    for j in range(size):
        column = rest[:, j] / jnp.sqrt(jnp.maximum(rest[j, j], _TINY))
        column = jnp.where(jnp.arange(size) >= j, column, 0.0)
        columns.append(column)
        rest = rest - column[:, None] * column[None]
    values = right
    lower = []
    for j in range(size):
        value = values[j] / columns[j][j]
        lower.append(value)
        values = values - value * columns[j]
    solution = jnp.stack(lower)
    for j in reversed(range(size)):
        above = jnp.sum(jnp.where(jnp.arange(size) > j, columns[j] * solution, 0.0))
        solution = solution.at[j].set((solution[j] - above) / columns[j][j])
    return solution


def _norm(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector * vector))


def _times(matrix: Array, vector: Array) -> Array:
    return jnp.sum(matrix * vector, axis=-1)


def _errors(problem: _Problem, acceleration: Array) -> tuple[Array, Array]:
    rows, cones = problem.rows, problem.cones
    return (
        _times(rows.jacobian, acceleration) - rows.target,
        _times(cones.jacobian, acceleration) - cones.target,
    )


def _generalised(problem: _Problem, row_force: Array, contact_force: Array) -> Array:
    of_rows = jnp.sum(problem.rows.jacobian * row_force[:, None], axis=0)
    return of_rows + jnp.sum(problem.cones.jacobian * contact_force[..., None], axis=(0, 1))


def _cost(problem: _Problem, acceleration: Array) -> Array:
    row_error, cone_error = _errors(problem, acceleration)
    away, rows = acceleration - problem.free, problem.rows
    active = rows.always | (row_error < 0)
    _, cost, _ = _cone_force(problem.cones, cone_error)
    return (
        0.5 * jnp.sum(away * _times(problem.inertia, away))
        + 0.5 * jnp.sum(jnp.where(active, rows.stiffness * row_error**2, 0.0))
        + cost
    )


def _row_force(rows: Rows, error: Array) -> Array:
    return jnp.where(rows.always | (error < 0), -rows.stiffness * error, 0.0)


class _Zones(NamedTuple):
    scaled: Array  # (c 4)
    normal: Array  # (c)
    tangent: Array  # (c) length
    sticks: Array  # (c) bool
    slides: Array  # (c) bool
    mass: Array  # (c)


def _zones(cones: Cones, error: Array) -> _Zones:
    scaled = error * cones.scale
    mu, normal = cones.scale[:, 0], scaled[:, 0]
    tangent = jnp.sqrt(jnp.sum(scaled[:, 1:] ** 2, axis=-1))
    slides = (tangent > 0) & (normal < mu * tangent) & (mu * normal + tangent > 0)
    sticks = jnp.where(tangent > 0, mu * normal + tangent <= 0, normal < 0)
    mass = cones.stiffness[:, 0] / jnp.maximum(mu * mu * (1 + mu * mu), _TINY)
    return _Zones(scaled, normal, tangent, sticks, slides, mass)


def _cone_force(cones: Cones, error: Array) -> tuple[Array, Array, _Zones]:
    """Forces (c 4), their cost, and the zones."""
    zones = _zones(cones, error)
    mu = cones.scale[:, 0]
    beyond = zones.normal - mu * zones.tangent
    push = -zones.mass * beyond * mu
    along = -push / jnp.where(zones.slides, zones.tangent, 1.0)
    sliding = jnp.concatenate(
        [push[:, None], along[:, None] * zones.scaled[:, 1:] * cones.scale[:, 1:]], axis=1
    )
    force = jnp.where(zones.sticks[:, None], -cones.stiffness * error, 0.0)
    force = jnp.where(zones.slides[:, None], sliding, force)
    stuck = jnp.where(zones.sticks, jnp.sum(cones.stiffness * error**2, axis=1), 0.0)
    slid = jnp.where(zones.slides, zones.mass * beyond**2, 0.0)
    return force, 0.5 * jnp.sum(stuck + slid), zones


def _cone_hessian(cones: Cones, zones: _Zones) -> Array:
    """Second derivatives (c 4 4) of each contact's cost by its four errors."""
    mu, u = cones.scale[:, 0], zones.scaled
    length = jnp.where(zones.slides, zones.tangent, 1.0)
    ratio = mu * zones.normal / length
    tangents = jnp.where(jnp.arange(4) > 0, u, 0.0) / length[:, None]
    diagonal = jnp.where(jnp.arange(4) > 0, (mu * mu - ratio)[:, None], 1.0)
    sliding = ratio[:, None, None] * tangents[:, :, None] * tangents[:, None, :]
    sliding = sliding + diagonal[:, :, None] * jnp.eye(4, dtype=u.dtype)
    first = jnp.arange(4) == 0
    cross = -mu[:, None] * tangents
    sliding = sliding + cross[:, None, :] * first[:, None] + cross[:, :, None] * first[None]
    outer = cones.scale[:, :, None] * cones.scale[:, None, :]
    sliding = zones.mass[:, None, None] * outer * sliding
    sticking = cones.stiffness[:, :, None] * jnp.eye(4, dtype=u.dtype)
    block = jnp.where(zones.sticks[:, None, None], sticking, 0.0)
    return jnp.where(zones.slides[:, None, None], sliding, block)


def _at(problem: _Problem, acceleration: Array) -> _Point:
    rows, cones = problem.rows, problem.cones
    row_error, cone_error = _errors(problem, acceleration)
    contact_force, cone_cost, zones = _cone_force(cones, cone_error)
    row_force = _row_force(rows, row_error)
    away = acceleration - problem.free
    pull = _times(problem.inertia, away)
    gradient = pull - _generalised(problem, row_force, contact_force)
    active = rows.always | (row_error < 0)
    weight = jnp.where(active, rows.stiffness, 0.0)
    cost = 0.5 * jnp.sum(away * pull) + 0.5 * jnp.sum(weight * row_error**2) + cone_cost

    blocks = _cone_hessian(cones, zones)
    weighted = jnp.sum(blocks[..., None] * cones.jacobian[:, None], axis=2)  # (c 4 v)
    size = problem.inertia.shape[0]
    flat, flat_weighted = cones.jacobian.reshape(-1, size), weighted.reshape(-1, size)
    hessian = problem.inertia + jnp.sum(flat[:, :, None] * flat_weighted[:, None, :], axis=0)
    hessian = hessian + jnp.sum(
        (rows.jacobian * weight[:, None])[:, :, None] * rows.jacobian[:, None, :], axis=0
    )
    return _Point(
        acceleration, row_error, cone_error, cost, gradient, -solve_positive(hessian, gradient)
    )


class _Bracket(NamedTuple):
    """A line search under way."""

    low: Any
    high: Any
    step: Any
    left: Any  # slope at the step before
    count: Any
    done: Any


def _line_search(problem: _Problem, point: _Point, iterations: int) -> Array:
    """Where the cost along the search direction is least: the root of its rising slope."""
    rows, cones, search = problem.rows, problem.cones, point.search
    row_rate = _times(rows.jacobian, search)
    cone_rate = _times(cones.jacobian, search)
    pull = _times(problem.inertia, search)
    offset = jnp.sum(pull * (point.acceleration - problem.free))
    square = jnp.sum(pull * search)
    mu = cones.scale[:, 0]
    rate = cone_rate * cones.scale

    def slope(step: Array) -> tuple[Array, Array]:
        row_error = point.row_error + step * row_rate
        weight = jnp.where(rows.always | (row_error < 0), rows.stiffness, 0.0)
        error = point.cone_error + step * cone_rate
        zones = _zones(cones, error)
        stuck = jnp.sum(cones.stiffness * error * cone_rate, axis=1)
        stuck_rate = jnp.sum(cones.stiffness * cone_rate**2, axis=1)
        length = jnp.where(zones.slides, zones.tangent, 1.0)
        stretch = jnp.sum(zones.scaled[:, 1:] * rate[:, 1:], axis=1) / length
        bend = (jnp.sum(rate[:, 1:] ** 2, axis=1) - stretch**2) / length
        beyond, change = zones.normal - mu * zones.tangent, rate[:, 0] - mu * stretch
        slid = zones.mass * beyond * change
        slid_rate = zones.mass * (change**2 - mu * beyond * bend)
        first = jnp.where(zones.sticks, stuck, 0.0) + jnp.where(zones.slides, slid, 0.0)
        second = jnp.where(zones.sticks, stuck_rate, 0.0) + jnp.where(zones.slides, slid_rate, 0.0)
        return (
            offset + step * square + jnp.sum(weight * row_error * row_rate) + jnp.sum(first),
            square + jnp.sum(weight * row_rate**2) + jnp.sum(second),
        )

    steepest = jnp.abs(jnp.sum(point.gradient * search))

    def go_on(state: _Bracket) -> Any:
        return ~state.done & (state.count < iterations)

    def narrow(state: _Bracket) -> _Bracket:
        first, second = slope(state.step)
        done = ~(jnp.abs(first) > _LINE_ENOUGH * steepest)  # also where it is not a number
        low = jnp.where(first < 0, state.step, state.low)
        high = jnp.where(first > 0, state.step, state.high)
        newton = state.step - first / jnp.maximum(second, _TINY)
        # Halved unless Newton's method is fast: at kinks it may creep along the bracket.
        fast = (newton > low) & (newton < high) & (jnp.abs(first) <= 0.5 * state.left)
        middle = jnp.where(jnp.isinf(high), 2.0 * state.step, 0.5 * (low + high))
        step = jnp.where(done, state.step, jnp.where(fast, newton, middle))
        return _Bracket(low, high, step, jnp.abs(first), state.count + 1, done)

    zero, one = jnp.zeros_like(steepest), jnp.ones_like(steepest)
    infinite = jnp.full_like(zero, jnp.inf)
    begin = _Bracket(zero, infinite, one, infinite, jnp.zeros((), jnp.int32), steepest == 0)
    found: Array = jax.lax.while_loop(go_on, narrow, begin).step
    return found
