"""Pairs of contacts to value: some with a closed form, and a mixture of all kinds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gmdx_kernels.epsilon.arrays import Array, Float

_X, _Y = np.eye(3)[:2]


@dataclass(frozen=True)
class PairBatch:
    """Arguments of `pair_epsilon`."""

    points: Float[Array, "n 2 3"]  # m
    normals: Float[Array, "n 2 3"]
    friction: Float[Array, "n"]
    torsion: Float[Array, "n"]  # m
    torque_scale: Float[Array, "n"]  # m
    origin: Float[Array, "n 3"]  # m

    def __getitem__(self, index: Any) -> "PairBatch":
        """The pairs at `index`."""
        return PairBatch(**{name: value[index] for name, value in vars(self).items()})


@dataclass(frozen=True)
class KnownPair:
    """A pair whose epsilon has a closed form."""

    name: str
    pair: PairBatch  # of one
    epsilon: float


def batch(
    points: Any,
    normals: Any,
    *,
    friction: float = 0.8,
    torsion: float = 0.003,
    torque_scale: float = 0.05,
    origin: Any = (0.0, 0.0, 0.0),
) -> PairBatch:
    """One pair as a batch."""
    return PairBatch(
        points=np.array([points], float),
        normals=np.array([normals], float),
        friction=np.array([friction]),
        torsion=np.array([torsion]),
        torque_scale=np.array([torque_scale]),
        origin=np.array([origin], float),
    )


def single(pairs: PairBatch, i: int) -> dict[str, Any]:
    """Pair i as arguments of a function for one grasp."""
    scalars = ("friction", "torsion", "torque_scale")
    return {k: float(v[i]) if k in scalars else v[i] for k, v in vars(pairs).items()}


def joined(batches: list[PairBatch]) -> PairBatch:
    """All pairs of several batches."""
    fields = [vars(b) for b in batches]
    return PairBatch(**{name: np.concatenate([f[name] for f in fields]) for name in fields[0]})


def known_pairs(seed: int = 0) -> list[KnownPair]:
    """Opposed aligned pairs, flat pairs, and pairs tilted out of closure."""
    rng = np.random.default_rng(seed)
    known = []
    examples = [(0.04, 0.04, 0.8, 0.4, 0.0, 0.0), (0.04, 0.1, 0.8, 0.004, 0.0, 0.0)]
    examples += [(0.04, 0.06, 0.8, 0.004, 0.03, 0.0)]
    for i in range(20):
        r, scale, mu = rng.uniform(0.01, 0.05), rng.uniform(0.02, 0.2), rng.uniform(0.2, 1.2)
        gamma, along = 10.0 ** rng.uniform(-3, 0), rng.uniform(-1, 1) * r
        off = rng.uniform(0, 0.05)
        examples.append((r, scale, mu, gamma, *((off, 0.0) if i % 2 else (0.0, along))))
    for i, (r, scale, mu, gamma, off, along) in enumerate(examples):
        pair = batch(
            [-r * _X, r * _X],
            [_X, -_X],
            friction=mu,
            torsion=gamma,
            torque_scale=scale,
            origin=off * _Y + along * _X,
        )
        if off > 0:
            t = mu**-2 + (off**2 + scale**2) / gamma**2
            root = np.sqrt((t + np.sqrt(t**2 - 4 * scale**2 / (mu * gamma) ** 2)) / 2)
            tip = (1 + off / (mu * r)) ** 2 + (1 + scale**2 / r**2) / mu**2
            value = min(1 / root, tip**-0.5)
        else:
            tip = 1 + ((r + abs(along)) ** 2 + scale**2) / (mu * r) ** 2
            value = min(gamma / scale, tip**-0.5)
        known.append(KnownPair(f"aligned {i}", pair, float(value)))
    for gamma, mu in ((0.0, 0.8), (0.0, 0.0), (0.003, 0.0)):
        pair = batch([-0.03 * _X, 0.03 * _X], [_X, -_X], friction=mu, torsion=gamma)
        known.append(KnownPair(f"flat, gamma {gamma}, mu {mu}", pair, 0.0))
    pair = batch([0.01 * _X, 0.01 * _X], [_X, -_X])
    known.append(KnownPair("coincident", pair, 0.0))
    for alpha in (0.9, 1.2, np.arctan(0.8) + 1e-3):
        c, s = np.cos(alpha), np.sin(alpha)
        pair = batch([-0.04 * _X, 0.04 * _X], [c * _X + s * _Y, -c * _X + s * _Y])
        known.append(KnownPair(f"tilted {alpha:.3f}", pair, float(-(s - 0.8 * c))))
    return known


def mixture(count: int, seed: int = 0) -> PairBatch:
    """Random pairs: realistic ones, near-degenerate ones and ones without closure."""
    rng = np.random.default_rng(seed)
    return joined([_random_pair(rng, i % 10) for i in range(count)])


def _random_pair(rng: np.random.Generator, kind: int) -> PairBatch:
    tilt, gamma, unit, mu, aside = 0.5, 0.003, 1.0, 0.8, 0.02
    if kind == 3:
        tilt = 0.0  # aligned
    elif kind == 4:
        tilt, gamma = 1e-5, 10.0 ** rng.uniform(-7, -4)
    elif kind == 5:
        gamma = 10.0 ** rng.uniform(-1, 1)
    elif kind == 6:
        unit = 1000.0  # millimetres
    elif kind == 8:
        tilt = 1.5  # mostly without closure
    elif kind == 9:
        mu, aside = rng.uniform(0.1, 1.5), 0.2
    axis = _unit(rng.normal(size=3))
    half = rng.uniform(0.005, 0.04)
    normals = np.stack([axis, -axis]) + tilt * rng.uniform(-1, 1, size=(2, 3))
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.stack([-half * axis, half * axis]) + rng.normal(size=3) * aside
    if kind == 7:  # the contact line grazes a friction cone from within
        side = _unit(np.cross(axis, rng.normal(size=3)))
        angle = np.arctan(mu) - 10.0 ** rng.uniform(-4, -1)
        normals = np.stack([np.cos(angle) * axis + np.sin(angle) * side, -axis])
    return batch(
        unit * points, normals, friction=mu, torsion=unit * gamma, torque_scale=unit * 0.05
    )


def _unit(v: Float[Array, "3"]) -> Float[Array, "3"]:
    return np.asarray(v / np.linalg.norm(v))
