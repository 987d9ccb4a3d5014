"""What a compiled step needs to know of models, as arrays: the gripper's part, and each object's.

A gripper that slides without turning has constant inertia and Jacobians, so that its dynamics are
a few constants. They are read from the compiled model; what they cannot express is refused.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from gmdx.arrays import Array
from gmdx.errors import UsageError
from gmdx.scenes.build import HEIGHT_QPOS, HEIGHT_QVEL, PREFIX, TABLE, GraspModel
from gmdx.trials.mjx_jax_hulls import Bucket, Hulls, object_hulls

DOFS = 9  # the object's three and three, the height and the two fingers
SLIDES = 3


class Rig(NamedTuple):
    """The gripper and the physics; g slides, a actuators, b boxes."""

    timestep: Any  # s
    gravity: Any  # (3) m/s^2
    impratio: Any
    tolerance: Any
    inertia: Any  # (g g) kg
    related: Any  # (g g) bool, entries that MuJoCo's inertia matrix has
    damping: Any  # (g) N s/m
    stiffness: Any  # (g) N/m
    rest: Any  # (g) m, of the springs
    moment: Any  # (a g)
    gain: Any  # (a)
    bias: Any  # (a 3) of 1, length and speed
    force_range: Any  # (a 2) N
    joint_range: Any  # (g 2) N, of the actuators' sum on a joint
    coupling: Any  # (g) row of the equality between the fingers
    coupling_offset: Any  # m
    coupling_weight: Any
    coupling_solref: Any  # (2)
    coupling_solimp: Any  # (5)
    limits: Any  # (g 2) m, infinite where there is none
    limit_weight: Any  # (g)
    limit_solref: Any  # (g 2)
    limit_solimp: Any  # (g 5)
    half: Any  # (b 3) m, of boxes
    origin: Any  # (b 3) m, of boxes at slides 0
    rotation: Any  # (b 3 3)
    slide: Any  # (b 3 g) movement of boxes with the slides
    weight: Any  # (b) inverse mass of boxes at the constraints
    table_friction: Any  # (b 2) of boxes on the table: sliding, torsional (0: none)
    table_solref: Any  # (b 2)
    table_solimp: Any  # (b 5)
    is_pad: Any  # (2 b) bool


class Body(NamedTuple):
    """An object; leading axes may run over objects."""

    mass: Any  # kg
    inertia: Any  # (3 3) kg m^2, in its frame
    weight: Any  # inverse mass at the constraints
    friction: Any  # (2) sliding, torsional (m)
    solref: Any  # (2)
    solimp: Any  # (5)
    scale: Any  # of the solver's cost
    hulls: Hulls


def read_rig(model: GraspModel) -> Rig:
    """The gripper's constants.

    Raises:
        UsageError: Naming what of the model the compiled step does not compute.
    """
    m = model.model
    _refuse(model)
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    full = np.zeros((m.nv, m.nv))
    for column, unit in zip(full, np.eye(m.nv), strict=True):
        mujoco.mj_mulM(m, data, column, unit)
    boxes = _gripper_geoms(model)
    slide = np.zeros((len(boxes), 3, SLIDES))
    for place, geom in enumerate(boxes):
        jacobian = np.zeros((3, m.nv))
        mujoco.mj_jacGeom(m, data, jacobian, None, geom)
        slide[place] = jacobian[:, HEIGHT_QVEL:]
    qpos = data.qpos[HEIGHT_QPOS:]
    moment = np.zeros((m.nu, m.nv))
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    joints = slice(1, 1 + SLIDES)
    row, offset, weight = _coupling(m)
    table = m.geom(TABLE).id
    mixed = [_mixed(m, table, geom) for geom in boxes]
    pads = [m.geom(PREFIX + pad).id for pad in model.gripper.pads]
    dofs = slice(HEIGHT_QVEL, HEIGHT_QVEL + SLIDES)
    return Rig(
        timestep=np.float64(m.opt.timestep),
        gravity=m.opt.gravity.copy(),
        impratio=np.float64(m.opt.impratio),
        tolerance=np.float64(m.opt.tolerance),
        inertia=full[dofs, dofs],
        related=_related(m)[dofs, dofs],
        damping=m.dof_damping[dofs].copy(),
        stiffness=m.jnt_stiffness[joints].reshape(SLIDES).copy(),
        rest=m.qpos_spring[HEIGHT_QPOS:].copy(),
        moment=moment[:, dofs],
        gain=m.actuator_gainprm[:, 0].copy(),
        bias=m.actuator_biasprm[:, :3]
        * (m.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE)[:, None],
        force_range=_range(m.actuator_forcelimited, m.actuator_forcerange),
        joint_range=_range(m.jnt_actfrclimited[joints], m.jnt_actfrcrange[joints]),
        coupling=row,
        coupling_offset=np.float64(offset),
        coupling_weight=np.float64(weight),
        coupling_solref=m.eq_solref[0].copy(),
        coupling_solimp=m.eq_solimp[0].copy(),
        limits=_range(m.jnt_limited[joints], m.jnt_range[joints]),
        limit_weight=m.dof_invweight0[dofs].copy(),
        limit_solref=m.jnt_solref[joints].copy(),
        limit_solimp=m.jnt_solimp[joints].copy(),
        half=m.geom_size[boxes].copy(),
        origin=data.geom_xpos[boxes] - slide @ qpos,
        rotation=data.geom_xmat[boxes].reshape(-1, 3, 3).copy(),
        slide=slide,
        weight=m.body_invweight0[m.geom_bodyid[boxes], 0].copy(),
        table_friction=np.stack([friction for friction, _, _ in mixed]),
        table_solref=np.stack([solref for _, solref, _ in mixed]),
        table_solimp=np.stack([solimp for _, _, solimp in mixed]),
        is_pad=np.array([[geom == pad for geom in boxes] for pad in pads]),
    )


def read_body(model: GraspModel, bounds: Bucket) -> Body:
    """An object's numbers.

    Raises:
        UsageError: Its hulls differ in what they should share, or do not fit under the bounds.
    """
    m, number = model.model, model.object_body
    geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] == number]
    for name in ("friction", "solref", "solimp", "priority", "condim"):
        values = getattr(m, f"geom_{name}")[geoms]
        if not np.all(values == values[0]):
            raise UsageError(f"the hulls of an object differ in geom_{name}: the step shares it")
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, m.body_iquat[number])
    rotation = axes.reshape(3, 3)
    first = geoms[0]
    return Body(
        mass=np.float64(m.body_mass[number]),
        inertia=rotation * m.body_inertia[number] @ rotation.T,
        weight=np.float64(m.body_invweight0[number, 0]),
        friction=m.geom_friction[first, :2].copy(),
        solref=m.geom_solref[first].copy(),
        solimp=m.geom_solimp[first].copy(),
        scale=np.float64(1.0 / (m.stat.meaninertia * m.nv)),
        hulls=object_hulls(model, bounds),
    )


def _refuse(model: GraspModel) -> None:
    m = model.model
    joint = mujoco.mjtJoint
    kinds = [joint.mjJNT_FREE, *[joint.mjJNT_SLIDE] * SLIDES]
    option = m.opt
    moving = np.delete(np.arange(1, m.nbody), model.object_body - 1)
    not_computed = {
        "joints other than a free object and three slides": list(m.jnt_type) != kinds,
        "a cone other than the elliptic": option.cone != mujoco.mjtCone.mjCONE_ELLIPTIC,
        "an integrator other than implicitfast": option.integrator
        != mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        "friction in joints": bool(np.any(m.dof_frictionloss)) or np.any(m.tendon_frictionloss),
        "springs, dampers, limits or inertia of tendons": np.any(m.tendon_stiffness)
        or np.any(m.tendon_damping)
        or np.any(m.tendon_limited)
        or np.any(m.tendon_armature),
        "couplings other than one of two joints": list(m.eq_type) != [mujoco.mjtEq.mjEQ_JOINT],
        "actuators with activation": m.na > 0,
        "limits of controls": np.any(m.actuator_ctrllimited),
        "gains that depend on the state": np.any(
            m.actuator_gaintype != mujoco.mjtGain.mjGAIN_FIXED
        ),
        "contact margins": np.any(m.geom_margin) or np.any(m.geom_gap) or np.any(m.jnt_margin),
        "geom pairs of their own": m.npair > 0,
        "gripper bodies that feel gravity": not np.all(m.body_gravcomp[moving] == 1),
        "air or water": option.density > 0 or option.viscosity > 0,
        "a gripper of other shapes than boxes": any(
            m.geom_type[g] != mujoco.mjtGeom.mjGEOM_BOX for g in _gripper_geoms(model)
        ),
        "an object whose mass centre is not its origin": bool(
            np.any(m.body_ipos[model.object_body])
        ),
    }
    refused = [what for what, there in not_computed.items() if there]
    if refused:
        raise UsageError(
            f"the JAX implementation does not compute {'; '.join(refused)}: "
            "use another implementation or backend"
        )


def _gripper_geoms(model: GraspModel) -> list[int]:
    """Geoms of the gripper that can touch something."""
    m = model.model
    return [
        geom
        for geom in range(m.ngeom)
        if m.geom_bodyid[geom] not in (0, model.object_body)
        and (m.geom_contype[geom] or m.geom_conaffinity[geom])
    ]


def _range(limited: Array, given: Array) -> Array:
    bounds: Array = np.where(np.asarray(limited, bool)[:, None], given, [-np.inf, np.inf])
    return bounds


def _related(m: mujoco.MjModel) -> Array:
    """Where the inertia matrix has entries: between a degree of freedom and its ancestors."""
    related = np.eye(m.nv, dtype=bool)
    for dof in range(m.nv):
        parent = int(m.dof_parentid[dof])
        while parent >= 0:
            related[dof, parent] = related[parent, dof] = True
            parent = int(m.dof_parentid[parent])
    return related


def _coupling(m: mujoco.MjModel) -> tuple[Array, float, float]:
    """Row, offset and weight of q1 - c0 - c1 q2 = 0, at reference positions 0."""
    first, second = int(m.eq_obj1id[0]), int(m.eq_obj2id[0])
    coefficients = m.eq_data[0, :5]
    reference = m.qpos0[m.jnt_qposadr[[first, second]]]
    if second < 0 or np.any(coefficients[2:]) or np.any(reference):
        raise UsageError("the JAX implementation computes linear couplings of two joints only")
    row = np.zeros(SLIDES)
    row[first - 1], row[second - 1] = 1.0, -coefficients[1]
    weight = float(m.dof_invweight0[m.jnt_dofadr[[first, second]]].sum())
    return row, float(coefficients[0]), weight


def _mixed(m: mujoco.MjModel, a: int, b: int) -> tuple[Array, Array, Array]:
    """Contact parameters of two geoms (MuJoCo's documentation, "Contact parameters")."""
    if m.geom_priority[a] != m.geom_priority[b]:
        first = a if m.geom_priority[a] > m.geom_priority[b] else b
        share, friction, condim = float(first == a), m.geom_friction[first], m.geom_condim[first]
    else:
        total = m.geom_solmix[a] + m.geom_solmix[b]
        share = float(m.geom_solmix[a] / total) if total > 0 else 0.5
        friction = np.maximum(m.geom_friction[a], m.geom_friction[b])
        condim = max(m.geom_condim[a], m.geom_condim[b])
    if condim not in (3, 4) or np.any(m.geom_solref[[a, b]] <= 0):
        raise UsageError("the JAX implementation computes contacts of condim 3 and 4 only")
    solref = share * m.geom_solref[a] + (1 - share) * m.geom_solref[b]
    solimp = share * m.geom_solimp[a] + (1 - share) * m.geom_solimp[b]
    return np.array([friction[0], friction[1] * (condim == 4)]), solref, solimp
