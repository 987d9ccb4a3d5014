"""Contacts to study epsilon on: one grasp's, and seeded sets of grasps."""

from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError
from gmdx.objects.prepare import PrepareConfig
from gmdx.rng import generator
from gmdx.scenes.physics import PhysicsConfig

FRICTION = PrepareConfig().friction  # as objects have it by default


class Parameters(TypedDict):
    """The keyword arguments of all that takes a grasp's contacts."""

    friction: float
    torsion: float  # m
    torque_scale: float  # m
    origin: Float[Array, "3"]  # m


@dataclass(frozen=True)
class Contacts:
    """One grasp's contacts and what they can exert; torques are about the origin 0."""

    points: Float[Array, "k 3"]  # m
    normals: Float[Array, "k 3"]  # unit, into the object
    friction: float
    torsion: float  # m
    torque_scale: float  # m

    @property
    def parameters(self) -> Parameters:
        """What functions take beside points and normals."""
        return Parameters(
            friction=self.friction,
            torsion=self.torsion,
            torque_scale=self.torque_scale,
            origin=np.zeros(3),
        )


@dataclass(frozen=True)
class GraspSet:
    """n grasps with k contacts each, about an origin at 0."""

    points: Float[Array, "n k 3"]  # m
    normals: Float[Array, "n k 3"]  # unit, into the object
    friction: float = FRICTION
    torsion: float = PhysicsConfig().torsion(FRICTION)  # m
    torque_scale: float = 0.06  # m

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: int) -> Contacts:
        """One grasp."""
        return Contacts(
            self.points[index], self.normals[index], self.friction, self.torsion, self.torque_scale
        )

    def first(self, count: int) -> "GraspSet":
        """The first grasps, all if there are fewer."""
        return replace(self, points=self.points[:count], normals=self.normals[:count])

    @property
    def parameters(self) -> Parameters:
        """What functions take beside points and normals."""
        return self[0].parameters


def random_pairs(count: int, *, seed: int = 0) -> GraspSet:
    """Two contacts as a parallel jaw makes them, with force closure.

    They are 1 to 6 cm apart, their normals some 15 degrees off the line between them, which
    passes the centre of mass at some 2 cm. A third of what is drawn slips, and is drawn again.
    """
    points, normals = np.empty((2, count, 2, 3))
    facing = np.array([[1.0], [-1.0]])
    for i in range(count):
        rng = generator(seed, "epsilon pair", i)
        line = _unit(rng.normal(size=3))
        while True:
            tilted = _unit(facing * line + 0.27 * rng.normal(size=(2, 3)))
            # Strictly inside both cones: clear of the border by a few degrees.
            if (facing * (tilted @ line)[:, None]).min() > np.cos(np.arctan(FRICTION) - 0.05):
                break
        points[i] = -facing * line * rng.uniform(0.005, 0.03) + 0.012 * rng.normal(size=3)
        normals[i] = tilted
    return GraspSet(points, normals)


def random_patches(count: int, *, contacts: int = 8, seed: int = 0) -> GraspSet:
    """Two opposed pads that each touch a curved surface at several points.

    Raises:
        ConfigError: The number of contacts is not even, or less than 2.
    """
    if contacts < 2 or contacts % 2:
        raise ConfigError(f"two pads share an even number of contacts from 2 on, not {contacts}")
    half = contacts // 2
    points, normals = np.empty((2, count, contacts, 3))
    for i in range(count):
        rng = generator(seed, "epsilon patches", contacts, i)
        frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        reach, offset = rng.uniform(0.005, 0.03), 0.012 * rng.normal(size=3)
        for side, rows in ((-1.0, slice(0, half)), (1.0, slice(half, None))):
            bend = rng.uniform(-20.0, 20.0, size=2)  # 1/m: the surface's curvatures there
            slope = 0.15 * rng.normal(size=2)
            across = rng.uniform(-0.008, 0.008, size=(half, 2))
            height = across @ slope + 0.5 * (across**2) @ bend
            local = np.column_stack([side * reach + height, across])
            inward = -side * np.column_stack([np.ones(half), -(slope + across * bend)])
            points[i, rows] = local @ frame.T + offset
            normals[i, rows] = _unit(inward) @ frame.T
    return GraspSet(points, normals)


def _unit(v: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    scaled: Array = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return scaled
