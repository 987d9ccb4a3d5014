"""Designs of global sensitivity analysis and what they yield, for any function of [0, 1]^d.

A design consists of blocks: Morris' trajectories, or the rows of Saltelli's scheme. A block in
which a value is missing anywhere says nothing about that output: it is left out, and counted.

Sources: Morris (1991), Technometrics 33(2); Campolongo et al. (2007), Environmental Modelling &
Software 22(10); Saltelli et al. (2010), Computer Physics Communications 181(2). The estimators
are SALib's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import UsageError
from gmdx.rng import generator

METHODS = ("morris", "sobol", "oat")
CONFIDENCE = 0.95
LEVELS = 4  # of Morris' grid: steps are 2/3 of a range
RESAMPLES = 1000  # of the bootstrap
_DEFAULT_BLOCKS = {"morris": 10, "sobol": 64, "oat": 7}
_LEAST_BLOCKS = {"morris": 2, "sobol": 16, "oat": 2}


@dataclass(frozen=True)
class Design:
    """Where to evaluate a function of d numbers in [0, 1]."""

    method: str
    names: tuple[str, ...]  # of the d numbers
    places: Float[Array, "r d"]  # where the function is evaluated
    units: Float[Array, "r d"]  # as the method drew them: `places` before their shift
    block: Int[Array, "r"]  # trajectory or row of the scheme; of oat: which number varies

    def __len__(self) -> int:
        return len(self.places)

    @property
    def blocks(self) -> int:
        """How many there are."""
        return int(self.block.max()) + 1


@dataclass(frozen=True)
class Indices:
    """Sensitivities of one output to d numbers; NaN where they could not be estimated.

    Of Morris, `main` is the mean effect and `total` the mean absolute effect (mu*) of a number's
    whole range, in the output's unit, and `spread` the effects' standard deviation. Of Sobol,
    `main` and `total` are the shares S1 and ST of the output's variance. `main_half` and
    `total_half` are half the width of their 95 % intervals (Morris gives none for the mean). Of
    oat, `main` is the difference between the range's ends and `total` that between the largest
    and the smallest value, both without interval.
    """

    names: tuple[str, ...]
    main: Float[Array, "d"]
    main_half: Float[Array, "d"]
    total: Float[Array, "d"]
    total_half: Float[Array, "d"]
    spread: Float[Array, "d"]
    blocks: int  # that say something
    blocks_left_out: int  # because a value is missing in them
    constant: bool = False  # the output has no variance to be shared

    def above(self, name: str) -> tuple[bool, ...]:
        """Whether each total lies above that of `name`, intervals counted: not noise."""
        at = self.names.index(name)
        half = np.nan_to_num(self.total_half)
        ceiling = self.total[at] + half[at]
        return tuple(bool(x) for x in self.total - half > ceiling)


def runs_in_block(method: str, count: int) -> int:
    """Runs that each block of a design for `count` numbers takes.

    Raises:
        UsageError: The method is unknown.
    """
    if method not in METHODS:
        raise UsageError(f"unknown method '{method}': give one of {', '.join(METHODS)}")
    return {"morris": count + 1, "sobol": count + 2, "oat": count}[method]


def make_design(
    method: str,
    names: Sequence[str],
    *,
    runs: int | None = None,
    seed: int = 0,
    levels: Sequence[int] | None = None,
    shifted: Sequence[str] = (),
) -> Design:
    """Places to evaluate, as many as the budget allows.

    Args:
        method: morris, sobol or oat (one at a time, at evenly spaced places).
        names: Of the d numbers.
        runs: Evaluations at most; by default 10 trajectories, 64 rows or 7 places each.
        seed: Of the design.
        levels: How many different values each number has, 0 where it is continuous; oat takes
            each of them once.
        shifted: Numbers that get another random shift in every block, modulo 1. For numbers
            that stand for chance: Morris' grid alone would draw on `LEVELS` values of them.

    Raises:
        UsageError: The method is unknown, the budget too small, or SALib missing.
    """
    size = runs_in_block(method, len(names))
    blocks = _DEFAULT_BLOCKS[method] if runs is None else runs // size
    if method == "sobol" and blocks > 0:
        blocks = 2 ** int(np.log2(blocks))  # the sequence is balanced at powers of two
    if blocks < _LEAST_BLOCKS[method]:
        raise UsageError(
            f"{runs} runs are too few: {method} with {len(names)} parameters needs "
            f"{_LEAST_BLOCKS[method] * size} at least; raise --runs or name fewer --parameters"
        )
    if method == "oat":
        return _one_at_a_time(names, blocks, [0] * len(names) if levels is None else levels)
    rng = generator(seed, "sensitivity", method)
    units = _sample(method, names, blocks, int(rng.integers(1, 2**31)))
    block = np.repeat(np.arange(blocks), size)
    places = units.copy()
    for name in shifted:
        column = list(names).index(name)
        places[:, column] = (units[:, column] + rng.random(blocks)[block]) % 1.0
    return Design(method, tuple(names), places, units, block)


def indices(design: Design, outputs: Float[Array, "r"], *, seed: int = 0) -> Indices:
    """Sensitivities from the values at a design's places; a missing value is NaN.

    Args:
        design: Where the function was evaluated.
        outputs: Its values there.
        seed: Of the bootstrap.

    Raises:
        UsageError: SALib is missing.
    """
    if design.method == "oat":
        return _swings(design, outputs)
    whole = ~np.isin(design.block, design.block[np.isnan(outputs)])
    used = len(np.unique(design.block[whole]))
    left_out = design.blocks - used
    kept = outputs[whole]
    constant = used > 0 and bool(np.ptp(kept) == 0)
    if used < 2 or (constant and design.method == "sobol"):
        return _unknown(design.names, used, left_out, constant)
    key = int(generator(seed, "sensitivity", "bootstrap").integers(1, 2**31))  # SALib: 0 is none
    problem = _problem(design.names)
    if design.method == "morris":
        found = _salib("analyze", "morris").analyze(
            problem, design.units[whole], kept, num_resamples=RESAMPLES, num_levels=LEVELS,
            conf_level=CONFIDENCE, seed=key,
        )  # fmt: skip
        main, half = found["mu"], np.full(len(design.names), np.nan)
        total, total_half, spread = found["mu_star"], found["mu_star_conf"], found["sigma"]
    else:
        found = _salib("analyze", "sobol").analyze(
            problem, kept, calc_second_order=False, num_resamples=RESAMPLES,
            conf_level=CONFIDENCE, seed=key,
        )  # fmt: skip
        main, half, total, total_half = (found[k] for k in ("S1", "S1_conf", "ST", "ST_conf"))
        spread = np.full(len(design.names), np.nan)
    return Indices(
        names=design.names,
        main=_filled(main),
        main_half=_filled(half),
        total=_filled(total),
        total_half=_filled(total_half),
        spread=_filled(spread),
        blocks=used,
        blocks_left_out=left_out,
        constant=constant,
    )


def _filled(values: Any) -> Float[Array, "d"]:
    """SALib's numbers, some of which are in masked arrays."""
    return np.asarray(np.ma.filled(values, np.nan), float)


def _sample(method: str, names: Sequence[str], blocks: int, seed: int) -> Float[Array, "r d"]:
    problem = _problem(names)
    units: Array
    if method == "morris":
        units = _salib("sample", "morris").sample(problem, blocks, num_levels=LEVELS, seed=seed)
    else:
        sampler = _salib("sample", "sobol")
        units = sampler.sample(problem, blocks, calc_second_order=False, seed=seed)
    clipped: Array = np.clip(np.asarray(units, float), 0.0, 1.0)
    return clipped


def _one_at_a_time(names: Sequence[str], places: int, levels: Sequence[int]) -> Design:
    """Evenly spaced places for each number in turn; NaN: leave that number at its default."""
    rows, block = [], []
    for k, count in enumerate(levels):
        own = (np.arange(count) + 0.5) / count if count else np.linspace(0.0, 1.0, places)
        for place in own:
            row = np.full(len(names), np.nan)
            row[k] = place
            rows.append(row)
            block.append(k)
    units = np.array(rows)
    return Design("oat", tuple(names), units, units, np.array(block))


def _swings(design: Design, outputs: Float[Array, "r"]) -> Indices:
    d = len(design.names)
    main, total = np.full(d, np.nan), np.full(d, np.nan)
    for k in range(d):
        values = outputs[design.block == k]
        if np.isfinite(values).all():
            main[k], total[k] = values[-1] - values[0], np.ptp(values)
    known = np.isfinite(total)
    none = np.full(d, np.nan)
    return Indices(
        design.names, main, none, total, none, none, int(known.sum()), int((~known).sum())
    )


def _unknown(names: tuple[str, ...], used: int, left_out: int, constant: bool) -> Indices:
    none = np.full(len(names), np.nan)
    return Indices(names, none, none, none, none, none, used, left_out, constant)


def _problem(names: Sequence[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def _salib(kind: str, method: str) -> Any:
    """A module of SALib, which takes a second to import.

    Raises:
        UsageError: It is not installed.
    """
    from importlib import import_module

    try:
        return import_module(f"SALib.{kind}.{method}")
    except ImportError as error:
        raise UsageError(
            f"morris and sobol need SALib ({error}): pip install 'gmdx[sensitivity]'"
        ) from error
