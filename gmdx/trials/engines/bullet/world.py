"""The table, an object and a gripper in PyBullet, made from the compiled MuJoCo model.

It is one world for one trial at a time, in the gripper's frame, with the states and sensors of
`GraspModel`, so that one set of rules reads both engines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pybullet

from gmdx.arrays import Array, Float, Int
from gmdx.errors import ConfigError
from gmdx.geometry import matrix_quaternion, quaternion_conjugate, quaternion_multiply
from gmdx.objects.model import ObjectModel
from gmdx.scenes.layout import SLOT_SIZE, ContactSensors, GraspModel
from gmdx.scenes.physics import GRAVITY, PhysicsConfig
from gmdx.trials.engines.bullet.gripper import FIXED, finger_limits, gripper_links


@dataclass(frozen=True)
class BulletConfig:
    """What Bullet needs and MuJoCo has no word for; all else is Bullet's default."""

    substeps: int = 4  # of a step of the schedule: at 4 ms a box slides up to twice too far
    iterations: int = 50  # of the contact solver: Bullet's default
    margin: float = 1e-5  # m, that hulls grow by: what Bullet lets contacts sink by, not its 1 mm
    coupling_force: float = 1e4  # N, at most, between the coupled fingers: as good as rigid
    coupling_erp: float = 0.8  # share of the fingers' disagreement that a substep corrects

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ConfigError(f"bullet: {name} must be positive, got {value}")


_TABLE, _OBJECT, _GRIPPER = 1, 2, 4  # collision groups
# Fields of a contact point of `getContactPoints`; body A is the one asked for first.
_LINK_B, _POINT_A, _POINT_B, _NORMAL, _DISTANCE, _PRESS = 4, 5, 6, 7, 8, 9


class BulletWorld:
    """One client of PyBullet; `reset` builds everything anew, so nothing is left of a trial."""

    def __init__(
        self, scene: GraspModel, obj: ObjectModel, physics: PhysicsConfig, config: BulletConfig
    ) -> None:
        self.scene, self.obj, self.config, self.physics = scene, obj, config, physics
        self.signs = np.array(scene.gripper.signs)
        self.slots = scene.sensors.slots
        width = self.slots * SLOT_SIZE
        self.sensors = ContactSensors(
            pads=(slice(0, width), slice(width, 2 * width)),
            hand=2 * width,
            hand_table=2 * width + 1,
            object_table=2 * width + 2,
        )
        self.sensor_count = 2 * width + 3
        moments, axes = np.linalg.eigh(obj.inertia)
        axes[:, 2] *= np.linalg.det(axes)  # a rotation, not a reflection
        # Bullet wants the principal axes as the body's own: hulls and poses are turned into them.
        self.moments, self.axes = moments, axes
        self.principal = matrix_quaternion(axes)
        self.links = gripper_links(scene)
        self.movers = [i for i, link in enumerate(self.links) if link.axis is not None]
        self.pads = [next(i for i, k in enumerate(self.links) if k.pad == n) for n in (0, 1)]
        self.folder = TemporaryDirectory(prefix="gmdx-bullet-")
        self.hulls = Path(self.folder.name) / "hulls.obj"
        self.hulls.write_text(_wavefront([hull @ axes for hull in obj.hulls]))
        self.client = pybullet.connect(pybullet.DIRECT)

    def close(self) -> None:
        """Disconnect, and remove what was written."""
        pybullet.disconnect(self.client)
        self.folder.cleanup()

    def reset(
        self,
        qpos: Float[Array, "q"],
        *,
        gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY),
    ) -> None:
        """Everything at rest at the given positions, under gravity (m/s^2)."""
        p, client = pybullet, self.client
        p.resetSimulation(physicsClientId=client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self.physics.timestep,
            numSubSteps=self.config.substeps,
            numSolverIterations=self.config.iterations,
            solverResidualThreshold=0.0,  # no early stop: every substep costs and does the same
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        p.setGravity(*gravity, physicsClientId=client)
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        self.table = p.createMultiBody(0.0, plane, physicsClientId=client)
        self.object = self._add_object(qpos)
        self.gripper = self._add_gripper(qpos)
        self._touch(self.table, _TABLE, _OBJECT | _GRIPPER, friction=1.0)
        self._touch(self.object, _OBJECT, _TABLE | _GRIPPER, friction=self.obj.friction)
        self._touch(self.gripper, _GRIPPER, _TABLE | _OBJECT, friction=1.0)
        # Bullet adds the products of one body's torsional and the other's sliding coefficient.
        torsion = self.physics.torsion(self.obj.friction)
        p.changeDynamics(self.object, -1, spinningFriction=torsion, physicsClientId=client)

    def step(self, control: Float[Array, "3"], force: Float[Array, "3"]) -> Float[Array, "d"]:
        """One step of the schedule; returns the contact sensors of its last substep."""
        p, client = pybullet, self.client
        height, speed, closing = control
        (z, rate), *_ = self._joints()
        dt, w = self.physics.timestep, self.physics.drive_frequency
        grips = 2 * [self.scene.gripper.force]
        # MuJoCo's servo, its damping implicit, as the speed that it would lead to.
        wanted = rate + dt * (w * w * (height - z) + 2.0 * w * (speed - rate)) / (
            1.0 + 2.0 * w * dt
        )
        p.setJointMotorControlArray(
            self.gripper,
            self.movers,
            p.VELOCITY_CONTROL,
            targetVelocities=[wanted, 0.5 * closing, 0.5 * closing],
            # Bullet grants a motor the whole step's impulse in each of its substeps.
            forces=[limit / self.config.substeps for limit in (self.physics.drive_force, *grips)],
            physicsClientId=client,
        )
        if force.any():
            position, _ = p.getBasePositionAndOrientation(self.object, physicsClientId=client)
            p.applyExternalForce(
                self.object, -1, force.tolist(), position, p.WORLD_FRAME, physicsClientId=client
            )
        p.stepSimulation(physicsClientId=client)
        return self._read_contacts()

    def state(self) -> tuple[Float[Array, "q"], Float[Array, "v"]]:
        """Positions and velocities, laid out as in `GraspModel` (the spin in the world's axes)."""
        p, client = pybullet, self.client
        position, turn = p.getBasePositionAndOrientation(self.object, physicsClientId=client)
        linear, angular = p.getBaseVelocity(self.object, physicsClientId=client)
        (z, rate), *fingers = self._joints()
        travel, speed = np.array(fingers).T
        quaternion = quaternion_multiply(
            np.array([turn[3], *turn[:3]]), quaternion_conjugate(self.principal)
        )
        order = np.argsort(self.scene.finger_qpos)
        qpos = np.concatenate([position, quaternion, [z], (self.signs * travel)[order]])
        return qpos, np.concatenate([linear, angular, [rate], (self.signs * speed)[order]])

    def _joints(self) -> list[tuple[float, float]]:
        """Position and velocity of the tool's height and of the fingers, closing positive."""
        states = pybullet.getJointStates(self.gripper, self.movers, physicsClientId=self.client)
        return [(state[0], state[1]) for state in states]

    def _add_object(self, qpos: Float[Array, "q"]) -> int:
        p, client = pybullet, self.client
        shape = p.createCollisionShape(
            p.GEOM_MESH, fileName=str(self.hulls), physicsClientId=client
        )
        w, x, y, z = quaternion_multiply(qpos[3:7], self.principal)
        body: int = p.createMultiBody(
            self.obj.mass,
            shape,
            basePosition=qpos[:3].tolist(),
            baseOrientation=[x, y, z, w],
            physicsClientId=client,
        )
        p.changeDynamics(
            body, -1, localInertiaDiagonal=self.moments.tolist(), physicsClientId=client
        )
        return body

    def _add_gripper(self, qpos: Float[Array, "q"]) -> int:
        p, client, links = pybullet, self.client, self.links
        body: int = p.createMultiBody(
            0.0,
            -1,
            linkMasses=[link.mass for link in links],
            linkCollisionShapeIndices=[self._shape(link.shape) for link in links],
            linkVisualShapeIndices=[-1 for _ in links],
            linkPositions=[link.position for link in links],
            linkOrientations=[link.orientation for link in links],
            linkInertialFramePositions=[FIXED[0] for _ in links],
            linkInertialFrameOrientations=[FIXED[1] for _ in links],
            linkParentIndices=[link.parent + 1 for link in links],
            linkJointTypes=[p.JOINT_PRISMATIC if link.axis else p.JOINT_FIXED for link in links],
            linkJointAxis=[link.axis or [0.0, 0.0, 1.0] for link in links],
            physicsClientId=client,
        )
        travel = self.signs * qpos[list(self.scene.finger_qpos)]
        for link, value in zip(self.movers, (qpos[7], *travel), strict=True):
            p.resetJointState(body, link, float(value), 0.0, physicsClientId=client)
        for link, (low, high) in zip(self.movers[1:], finger_limits(self.scene), strict=True):
            p.changeDynamics(
                body, link, jointLowerLimit=low, jointUpperLimit=high, physicsClientId=client
            )
        _, left, right = self.movers
        coupling = p.createConstraint(
            body, left, body, right, p.JOINT_GEAR, [1, 0, 0], *2 * [FIXED[0]],
            physicsClientId=client,
        )  # fmt: skip
        p.changeConstraint(
            coupling,
            gearRatio=-1.0,
            maxForce=self.config.coupling_force,
            erp=self.config.coupling_erp,
            relativePositionTarget=0.0,
            physicsClientId=client,
        )
        return body

    def _shape(self, arguments: dict[str, Any] | None) -> int:
        """A geom's shape with the configured margin, which Bullet only sets on a base's shape."""
        if arguments is None:
            return -1
        p, client = pybullet, self.client
        shape: int = p.createCollisionShape(**arguments, physicsClientId=client)
        base = p.createMultiBody(0.0, shape, physicsClientId=client)
        p.changeDynamics(base, -1, collisionMargin=self.config.margin, physicsClientId=client)
        p.removeBody(base, physicsClientId=client)
        return shape

    def _touch(self, body: int, group: int, mask: int, *, friction: float) -> None:
        """Who touches whom, and how: no restitution, no damping, no sleep, and friction.

        Bullet multiplies two bodies' coefficients, so all but the object have 1.
        """
        p, client = pybullet, self.client
        # Bullet applies these to the base whatever the link, and with them all else in the call.
        p.changeDynamics(
            body,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            collisionMargin=self.config.margin,
            activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        for link in range(-1, p.getNumJoints(body, physicsClientId=client)):
            p.setCollisionFilterGroupMask(body, link, group, mask, physicsClientId=client)
            p.changeDynamics(
                body,
                link,
                lateralFriction=friction,
                rollingFriction=0.0,
                spinningFriction=0.0,
                restitution=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )

    def _read_contacts(self) -> Float[Array, "d"]:
        """The contacts that overlap or carry force, as MuJoCo's sensors report them."""
        p, client, layout = pybullet, self.client, self.sensors
        sensors = np.zeros(self.sensor_count)
        hand = _touching(p.getContactPoints(self.object, self.gripper, physicsClientId=client))
        sensors[layout.hand] = len(hand)
        for side in (0, 1):
            by_pad = [c for c in hand if c[_LINK_B] == self.pads[side]]
            contacts = sorted(by_pad, key=lambda c: -c[_PRESS])
            slots = sensors[layout.pads[side]].reshape(-1, SLOT_SIZE)
            for slot, c in zip(slots, contacts, strict=False):
                middle = 0.5 * (np.array(c[_POINT_A]) + c[_POINT_B])
                # A substep's impulse, but divided by the whole step.
                press = c[_PRESS] * self.config.substeps
                slot[:] = [len(contacts), press, 0.0, 0.0, c[_DISTANCE], *middle, *c[_NORMAL]]
        for index, body in ((layout.hand_table, self.gripper), (layout.object_table, self.object)):
            found = _touching(p.getContactPoints(self.table, body, physicsClientId=client))
            sensors[index] = len(found)
        return sensors


def _wavefront(hulls: Sequence[Float[Array, "_ 3"]]) -> str:
    """An OBJ file of which Bullet makes one compound: a convex hull of each group's vertices."""
    lines, first = [], 1
    for number, hull in enumerate(hulls):
        lines.append(f"o hull_{number}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in hull]
        corners: Int[Array, k] = np.arange(-(-len(hull) // 3) * 3) % len(hull) + first
        lines += [f"f {a} {b} {c}" for a, b, c in corners.reshape(-1, 3)]
        first += len(hull)
    return "\n".join(lines) + "\n"


def _touching(contacts: Sequence[tuple[Any, ...]] | None) -> list[tuple[Any, ...]]:
    """Bullet also keeps the contacts that are about to close."""
    return [c for c in contacts or () if c[_DISTANCE] <= 0.0 or c[_PRESS] > 0.0]
