"""MuJoCo models of a table with an object, and of a gripper above them.

A trial's model lives in the gripper's frame: the gripper only moves up and down at the origin,
and the object is placed where the grasp wants it. The table is the plane z = 0 in both frames.
So one model serves every grasp on an object, and a turn of the world changes nothing.
"""

from typing import Any

import mujoco
import numpy as np

from gmdx.objects.model import ObjectModel
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.layout import MOUNT, OBJECT, PAD_SLOTS, PREFIX, TABLE, ContactSensors, GraspModel
from gmdx.scenes.physics import GRAVITY, PhysicsConfig

# (contype & other's conaffinity) decides who touches whom: the gripper never touches itself.
_TABLE_AFFINITY, _OBJECT_TYPE, _GRIPPER_TYPE = 3, 2, 1


def table_and_object(obj: ObjectModel, physics: PhysicsConfig) -> mujoco.MjSpec:
    """The table z = 0 and the object as a free body, ready to compile or to add to."""
    spec = mujoco.MjSpec()
    spec.memory = physics.memory
    option = spec.option
    option.timestep = physics.timestep
    option.gravity = [0.0, 0.0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.impratio = physics.impratio
    option.iterations = physics.iterations
    option.ls_iterations = physics.ls_iterations
    option.tolerance = physics.tolerance
    # MuJoCo would put a diverged trial back to its start, where it looks like a failed grasp.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    spec.worldbody.add_geom(
        name=TABLE,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=0,
        conaffinity=_TABLE_AFFINITY,
    )
    body = spec.worldbody.add_body(
        name=OBJECT, mass=obj.mass, ipos=[0.0, 0.0, 0.0], explicitinertial=True
    )
    I = obj.inertia  # noqa: E741
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    body.add_freejoint()
    torsion = physics.torsion(obj.friction)
    for i, hull in enumerate(obj.hulls):
        spec.add_mesh(
            name=f"hull_{i}",
            uservert=np.asarray(hull, float).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        body.add_geom(
            name=f"hull_{i}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"hull_{i}",
            contype=_OBJECT_TYPE,
            conaffinity=_GRIPPER_TYPE,
            # The object's contact parameters hold in every contact: engines combine two
            # coefficients by different rules, so none is left to combine.
            priority=1,
            condim=4,
            friction=[obj.friction, torsion, 1e-4],
            solref=list(physics.solref),
            solimp=[*physics.solimp, 0.5, 2.0],
        )
    return spec


def scene_model(obj: ObjectModel, physics: PhysicsConfig) -> mujoco.MjModel:
    """The object alone on the table; qpos is its position (3) and quaternion (4)."""
    return table_and_object(obj, physics).compile()


def grasp_model(obj: ObjectModel, gripper: Gripper, physics: PhysicsConfig) -> GraspModel:
    """The gripper above the table with the object, driven in height and opening."""
    spec = table_and_object(obj, physics)
    spec.assets.update(gripper.files)  # attaching a body leaves its files behind
    mount = spec.worldbody.add_body(name=MOUNT, gravcomp=1.0)
    mount.add_joint(
        name=MOUNT,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0.0, 0.0, 1.0],
        actfrclimited=True,
        actfrcrange=[-physics.drive_force, physics.drive_force],
    )
    rotation = np.zeros(4)
    mujoco.mju_mat2Quat(rotation, gripper.rotation.ravel())
    frame = mount.add_frame(pos=-gripper.rotation @ gripper.tool_point, quat=rotation)
    frame.attach_body(_bare_root(gripper, physics), PREFIX, "")
    _drive_height(spec)
    _drive_fingers(spec, gripper, physics)
    _add_sensors(spec, gripper)
    model = spec.compile()

    _tune_height_servo(model, physics)
    fingers = [model.joint(PREFIX + name).qposadr[0] for name in gripper.joints]
    return GraspModel(
        model=model,
        gripper=gripper,
        finger_qpos=(int(fingers[0]), int(fingers[1])),
        object_body=model.body(OBJECT).id,
        sensors=_sensor_layout(model),
    )


def _bare_root(gripper: Gripper, physics: PhysicsConfig) -> mujoco.MjsBody:
    """The gripper's root body without its own actuators, sensors and couplings."""
    spec = mujoco.MjSpec.from_string(gripper.xml, assets=dict(gripper.files))
    for group in (spec.actuators, spec.sensors, spec.equalities, spec.tendons, spec.keys):
        for element in list(group):
            spec.delete(element)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = _GRIPPER_TYPE, 0
    for body in spec.bodies:
        body.gravcomp = 1.0  # the arm that carries the gripper holds its weight
    for joint in spec.joints:
        # Reflected inertia of the drive: light fingers alone would jump to metres a second
        # in one step of the closing force.
        joint.armature = gripper.force / physics.closing_acceleration
        joint.solref_limit, joint.solimp_limit = [0.01, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
    root = spec.worldbody.first_body()
    root.pos, root.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # Euler angles would win over quat
    return root


def _drive_height(spec: mujoco.MjSpec) -> None:
    """A position and a speed servo on the mount: a scheduled motion is followed without lag."""
    for name in ("height", "speed"):
        actuator = spec.add_actuator(name=name, target=MOUNT, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if name == "height":
            actuator.set_to_position(kp=1.0)
        else:
            actuator.set_to_velocity(kv=1.0)


def _tune_height_servo(model: mujoco.MjModel, physics: PhysicsConfig) -> None:
    """Gains for a critically damped servo of the configured frequency, whatever it carries."""
    mass = float(model.body_subtreemass[model.body(MOUNT).id])
    stiffness = mass * physics.drive_frequency**2
    damping = 2.0 * mass * physics.drive_frequency
    height, speed = model.actuator("height").id, model.actuator("speed").id
    model.actuator_gainprm[height, 0], model.actuator_biasprm[height, 1] = stiffness, -stiffness
    model.actuator_gainprm[speed, 0], model.actuator_biasprm[speed, 2] = damping, -damping


def _drive_fingers(spec: mujoco.MjSpec, gripper: Gripper, physics: PhysicsConfig) -> None:
    """One force-limited actuator closes both fingers, which are coupled like a real gripper's."""
    tendon = spec.add_tendon(name="closing")
    for joint, sign in zip(gripper.joints, gripper.signs, strict=True):
        tendon.wrap_joint(PREFIX + joint, sign)
    # Four times the gain that reaches the limit at standstill: full force while stalled, and
    # close to the wanted speed while free.
    actuator = spec.add_actuator(
        name="closing",
        target="closing",
        trntype=mujoco.mjtTrn.mjTRN_TENDON,
        forcelimited=True,
        forcerange=[-gripper.force, gripper.force],
    )
    actuator.set_to_velocity(kv=4.0 * gripper.force / (2.0 * physics.closing_speed))
    coupling = spec.add_equality(
        name="coupling",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=PREFIX + gripper.joints[1],
        name2=PREFIX + gripper.joints[0],
        solref=[0.01, 1.0],
        solimp=[0.99, 0.999, 0.001, 0.5, 2.0],
    )
    coupling.data[:2] = [0.0, gripper.signs[0] * gripper.signs[1]]


_PAD_DATA = ("FOUND", "FORCE", "DIST", "POS", "NORMAL")


def _add_sensors(spec: mujoco.MjSpec, gripper: Gripper) -> None:
    geom, subtree = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_XBODY
    found = _data_bits("FOUND")
    strongest = 2  # "maxforce", MJCF's attribute `reduce`

    def add(name: str, first: tuple[Any, str], second: tuple[Any, str], parameters: Any) -> None:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=first[0],
            objname=first[1],
            reftype=second[0],
            refname=second[1],
            intprm=parameters,
        )

    for side, pad in enumerate(gripper.pads):
        parameters = [_data_bits(*_PAD_DATA), strongest, PAD_SLOTS]
        add(f"pad_{side}", (geom, PREFIX + pad), (subtree, OBJECT), parameters)
    add("hand", (subtree, MOUNT), (subtree, OBJECT), [found, 0, 1])
    add("hand_table", (subtree, MOUNT), (geom, TABLE), [found, 0, 1])
    add("object_table", (subtree, OBJECT), (geom, TABLE), [found, 0, 1])


def _data_bits(*names: str) -> int:
    return sum(1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{name}")) for name in names)


def _sensor_layout(model: mujoco.MjModel) -> ContactSensors:
    def span(name: str) -> slice:
        sensor = model.sensor(name)
        return slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))

    return ContactSensors(
        pads=(span("pad_0"), span("pad_1")),
        hand=span("hand").start,
        hand_table=span("hand_table").start,
        object_table=span("object_table").start,
    )
