"""Which models can share a compiled step: those that differ in their object alone."""

from collections.abc import Sequence

import numpy as np

from gmdx.arrays import Array
from gmdx.errors import UsageError
from gmdx.scenes.build import HEIGHT_QVEL, GraspModel

# What may differ between objects of one compiled step: all of it is in `Body`, follows from it,
# or serves the C engine alone.
_OF_OBJECT = frozenset(
    {
        *("body_mass", "body_inertia", "body_iquat", "body_invweight0", "body_subtreemass"),
        *("body_sameframe", "body_simple", "dof_M0", "dof_invweight0", "dof_length"),
        *("dof_simplenum", "geom_friction", "geom_pos", "geom_quat", "geom_size", "geom_aabb"),
        *("geom_rbound", "geom_sameframe", "geom_dataid", "geom_solref", "geom_solimp"),
    }
)
_OF_ENGINE = (
    *("mesh_", "bvh_", "names", "name_", "M_", "mapM2", "mapD2", "body_bvh", "body_geom"),
    "sensor_",
)


def check_alike(models: Sequence[GraspModel]) -> None:
    """Models of one compiled step may differ in nothing that `Body` does not hold.

    Raises:
        UsageError: Naming the fields that differ.
    """
    first = models[0]
    differing = sorted({name for model in models[1:] for name in _differing(first, model)})
    if differing:
        raise UsageError(
            f"models of one batch differ in {', '.join(differing)}, which the JAX implementation "
            "holds only once: run them in batches of their own"
        )


def _differing(a: GraspModel, b: GraspModel) -> list[str]:
    public = [n for n in dir(a.model) if not n.startswith("_")]
    names = [n for n in public if isinstance(getattr(a.model, n, None), np.ndarray)]
    found = [n for n in names if not n.startswith(_OF_ENGINE) and not _same(a, b, n)]
    for name in ("timestep", "impratio", "tolerance", "gravity", "iterations", "ls_iterations"):
        if np.any(getattr(a.model.opt, name) != getattr(b.model.opt, name)):
            found.append(f"opt.{name}")
    return found


def _same(a: GraspModel, b: GraspModel, name: str) -> bool:
    """Whether a field is the same in two models, what belongs to the object aside."""
    x, y = getattr(a.model, name), getattr(b.model, name)
    if name in _OF_OBJECT or name.startswith("geom_"):
        x, y = x[_others(a, name)], y[_others(b, name)]
        if name.startswith("geom_") and name not in _OF_OBJECT:
            own = [getattr(m.model, name)[~_others(m, name)][0] for m in (a, b)]
            if not np.array_equal(own[0], own[1]):
                return False
    return np.array_equal(x, y)


def _others(model: GraspModel, name: str) -> Array:
    """Rows of a field that are not the object's."""
    m = model.model
    if name.startswith("body_"):
        rows = ~np.isin(np.arange(m.nbody), [0, model.object_body])  # the world sums up all
    elif name.startswith("dof_"):
        rows = np.arange(m.nv) >= HEIGHT_QVEL
    else:
        rows = m.geom_bodyid != model.object_body
    others: Array = rows
    return others
