"""What ways to compute epsilon cost, and by how much they miss it, on the same grasps.

All figures are processor seconds, so they hold for one core whatever else the machine does.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gmdx_kernels.epsilon import IMPLEMENTATIONS, PairEpsilon, pair_epsilon

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError
from gmdx.metrics.epsilon import Epsilon, epsilon
from gmdx.studies.epsilon.approximations import (
    linearised_epsilon,
    random_direction_bound,
    sampled_epsilon,
)
from gmdx.studies.epsilon.contacts import Contacts, GraspSet, random_pairs, random_patches

BULK_LIMIT, PAIR_LIMIT, PATCH_LIMIT = 0.3, 10.0, 100.0  # ms a grasp, on one core


@dataclass(frozen=True)
class MethodFigures:
    """What one method cost and by how much it missed."""

    method: str
    contacts: int
    grasps: int
    milliseconds: float  # processor time a grasp
    error_median: float  # relative to the certified value; of what is proved, the relative gap
    error_worst: float  # the largest in size, with its sign
    proved: bool  # whether the errors are proved gaps
    limit: float | None = None  # ms a grasp that must not be exceeded
    first_call_seconds: float | None = None  # of processor time, compilation included

    @property
    def per_second(self) -> float:
        """Grasps a second on one core."""
        return 1e3 / self.milliseconds

    @property
    def within(self) -> bool | None:
        """Whether the limit holds; None without a limit."""
        return None if self.limit is None else self.milliseconds <= self.limit


@dataclass(frozen=True)
class EpsilonFigures:
    """Every method on the same grasps, in one run."""

    seed: int
    friction: float
    torsion: float  # m
    torque_scale: float  # m
    methods: tuple[MethodFigures, ...]


@dataclass(frozen=True)
class EpsilonStudyConfig:
    """How many grasps each method gets: at most, where it is slow."""

    pairs: int = 1000
    patches: int = 200  # grasps with eight contacts
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.pairs, self.patches) < 1:
            raise ConfigError(
                f"a comparison needs 1 grasp or more, not {self.pairs} pairs and "
                f"{self.patches} grasps with patches"
            )


def epsilon_figures(config: EpsilonStudyConfig | None = None) -> EpsilonFigures:
    """Time every method on pairs and on grasps with eight contacts, and compare their values."""
    config = EpsilonStudyConfig() if config is None else config
    pairs = random_pairs(config.pairs, seed=config.seed)
    patches = random_patches(config.patches, seed=config.seed)
    return EpsilonFigures(
        config.seed,
        pairs.friction,
        pairs.torsion,
        pairs.torque_scale,
        (*_on_pairs(pairs), *_on_patches(patches)),
    )


def _on_pairs(pairs: GraspSet) -> list[MethodFigures]:
    certified, reference = _certified(pairs, "certified to 1e-4", rtol=1e-4, limit=PAIR_LIMIT)
    bulk = [
        _bulk(pairs, reference, name, prove=p) for name in IMPLEMENTATIONS for p in (False, True)
    ]
    found = [*bulk, certified]
    for name, method, most in (
        ("100,000 random directions", _random, 200),
        ("linearised cones, 8 edges", _cones(8), 400),
        ("linearised cones, 16 edges", _cones(16), 200),
        ("linearised cones, 64 edges", _cones(64), 50),
        ("as in Dex-Net, 8 edges", _cones(8, free_torsion=True), 400),
        ("as in Dex-Net, 64 edges", _cones(64, free_torsion=True), 50),
        ("limit surface, 8 points", _surface(8), 400),
        ("limit surface, 16 points", _surface(16), 200),
        ("limit surface, 64 points", _surface(64), 50),
    ):
        found.append(_compared(pairs.first(most), reference, name, method))
    return found


def _on_patches(patches: GraspSet) -> list[MethodFigures]:
    coarse, _ = _certified(patches, "certified to 1 %", rtol=1e-2, limit=PATCH_LIMIT)
    fine, reference = _certified(patches, "certified to 1e-4", rtol=1e-4, limit=None)
    found = [coarse, fine]
    for name, method, most in (
        ("100,000 random directions", _random, 100),
        ("linearised cones, 8 edges", _cones(8), 50),
        ("linearised cones, 16 edges", _cones(16), 50),
        ("limit surface, 8 points", _surface(8), 50),
    ):
        found.append(_compared(patches.first(most), reference, name, method))
    return found


_Method = Callable[[Contacts], float]


def _cones(edges: int, *, free_torsion: bool = False) -> _Method:
    def value(g: Contacts) -> float:
        return linearised_epsilon(
            g.points, g.normals, **g.parameters, edges=edges, free_torsion=free_torsion
        ).value

    return value


def _surface(samples: int) -> _Method:
    def value(g: Contacts) -> float:
        return sampled_epsilon(g.points, g.normals, **g.parameters, samples=samples).value

    return value


def _random(g: Contacts) -> float:
    return random_direction_bound(g.points, g.normals, **g.parameters).value


def _certified(
    grasps: GraspSet, name: str, *, rtol: float, limit: float | None
) -> tuple[MethodFigures, Float[Array, "n"]]:
    """The certified routine, and its values as reference for the others."""

    def certify(g: Contacts) -> Epsilon:
        return epsilon(g.points, g.normals, **g.parameters, rtol=rtol)

    certify(grasps[0])  # what only the first call pays is not counted
    start = time.process_time()
    found = [certify(grasps[i]) for i in range(len(grasps))]
    seconds = time.process_time() - start
    gaps = np.array([one.gap for one in found])
    figures = _figures(grasps, name, seconds, gaps, proved=True, limit=limit)
    return figures, np.array([one.upper for one in found])


def _bulk(
    grasps: GraspSet, reference: Float[Array, "n"], implementation: str, *, prove: bool
) -> MethodFigures:
    """One implementation of the kernel for pairs, on all of them at once."""

    def run() -> PairEpsilon:
        return pair_epsilon(
            grasps.points,
            grasps.normals,
            **grasps.parameters,
            implementation=implementation,
            prove=prove,
        )

    start = time.process_time()
    run()
    first = time.process_time() - start
    start = time.process_time()
    found = run()
    seconds = time.process_time() - start
    errors = (found.upper - found.lower) / found.upper if prove else found.upper / reference - 1.0
    return _figures(
        grasps,
        f"bulk kernel, {implementation}{', proved' if prove else ''}",
        seconds,
        errors,
        proved=prove,
        limit=None if prove else BULK_LIMIT,
        first_call_seconds=first,
    )


def _compared(
    grasps: GraspSet, reference: Float[Array, "m"], name: str, method: _Method
) -> MethodFigures:
    start = time.process_time()
    values = np.array([method(grasps[i]) for i in range(len(grasps))])
    seconds = time.process_time() - start
    return _figures(grasps, name, seconds, values / reference[: len(grasps)] - 1.0)


def _figures(
    grasps: GraspSet,
    method: str,
    seconds: float,
    errors: Float[Array, "n"],
    *,
    proved: bool = False,
    limit: float | None = None,
    first_call_seconds: float | None = None,
) -> MethodFigures:
    return MethodFigures(
        method=method,
        contacts=grasps.points.shape[1],
        grasps=len(grasps),
        milliseconds=1e3 * seconds / len(grasps),
        error_median=float(np.median(errors)),
        error_worst=float(errors[np.abs(errors).argmax()]),
        proved=proved,
        limit=limit,
        first_call_seconds=first_call_seconds,
    )
