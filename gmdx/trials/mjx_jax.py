"""Batched trials in JAX, for TPUs and whatever else XLA compiles for, on one device or several.

The scheme is MJX's, one world's step batched and compiled as a whole, but the step is our own. In
MJX's hulls are static, so that it compiles anew for each object, whole bodies have no contact
sensors, and elliptic cones are dense over all contacts that could be. Where C MuJoCo finds the same
contacts, this step agrees with its own to rounding. It serves all objects of a bucket, all phases
and any mixture.
"""

import functools
import importlib.metadata
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding

from gmdx.arrays import Array, Float, Int
from gmdx.caches import keep_jax_compilations
from gmdx.errors import DeviceMemoryError, UsageError
from gmdx.scenes.build import HEIGHT_QPOS, GraspModel
from gmdx.trials.frames import Digest, Stretch, joined
from gmdx.trials.mjx import OBJECTS
from gmdx.trials.mjx_jax_alike import check_alike
from gmdx.trials.mjx_jax_chunk import Outcome, by_trial, compiled_chunk, on_each
from gmdx.trials.mjx_jax_constraints import Shape
from gmdx.trials.mjx_jax_hulls import Bucket, bucket
from gmdx.trials.mjx_jax_rig import read_body, read_rig
from gmdx.trials.protocol import TrialConfig

_T = TypeVar("_T")

__all__ = ["JaxWorlds", "bucket", "device", "open_worlds", "suggested_capacity"]

_PIECE = 16  # trials of one call on a CPU, whatever the capacity: more at once are not faster
_SMALLER = 8  # on an accelerator a second step is compiled for so much smaller batches
_MOST_PAIRS = {2: 16, 8: 20, 16: 24, 32: 28, 64: 32, 128: 40}  # by hulls
_CONTACTS = 40  # of the gripper with the object; C MuJoCo finds up to 18 on the busiest objects
_ON_TABLE = 48  # contacts of the object with the table
_BYTES_AN_EDGE = 700  # of a pair, while its contacts are computed, in double precision
_MEMORY_SHARE = 0.7  # of the free memory that trials may take
_SINGLE_TOLERANCE = 1e-8  # of the solver where numbers have seven digits


class JaxWorlds:
    """Some objects of one bucket, and room for trials of them side by side."""

    def __init__(
        self,
        models: Sequence[GraspModel],
        *,
        capacity: int,
        devices: Sequence[Any] | None = None,
        double: bool | None = None,
    ) -> None:
        """Put the objects on the devices.

        Args:
            models: At most `OBJECTS`, alike but for the object.
            capacity: Trials side by side.
            devices: JAX's; None takes all of them.
            double: Whether to compute in double precision; None does so unless on a TPU.

        Raises:
            UsageError: The models cannot be side by side, or need what the step does not compute.
            DeviceMemoryError: There is no room for the objects.
        """
        if not 0 < len(models) <= OBJECTS:
            raise UsageError(f"give 1 to {OBJECTS} models, not {len(models)}")
        buckets = [bucket(model) for model in models]
        if len(set(buckets)) > 1:
            raise UsageError(f"models of one batch must share one bucket, not {set(buckets)}")
        check_alike(models)
        keep_jax_compilations()
        self.devices = list(jax.devices() if devices is None else devices)
        self.double = self.devices[0].platform != "tpu" if double is None else double
        self.sizes = _sizes(capacity, len(self.devices), self.devices[0].platform)
        self.capacity, self.timestep = capacity, float(models[0].model.opt.timestep)
        self.mesh = Mesh(np.array(self.devices), ("trials",))
        self.shape = _shape(models[0], buckets[0])
        rig, bodies = read_rig(models[0]), [read_body(model, buckets[0]) for model in models]
        bodies += bodies[:1] * (OBJECTS - len(bodies))
        if not self.double:
            rig = rig._replace(tolerance=np.maximum(rig.tolerance, _SINGLE_TOLERANCE))
        with jax.enable_x64(self.double):
            shared = on_each(self.mesh)
            self.rig = _guarded(lambda: _put(rig, self.double, shared))
            library = jax.tree.map(lambda *values: np.stack(values), *bodies)
            self.bodies = _guarded(lambda: _put(library, self.double, shared))

    @property
    def lanes(self) -> int:
        """Launches that may be under way at once."""
        return 2

    def launch(
        self,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> Callable[[], Stretch]:
        """Queue the steps of trials; see `gmdx.trials.mjx.Worlds.launch`."""
        size = next((size for size in self.sizes if len(index) <= size), self.sizes[-1])
        parts = [slice(start, start + size) for start in range(0, len(index), size)]
        waiting = [
            self._queue(size, index[part], state[part], control[part], force, count[part])
            for part in parts
        ]

        def wait() -> Stretch:
            return joined(
                [
                    _guarded(functools.partial(self._fetch, found, state[part], count[part]))
                    for part, found in zip(parts, waiting, strict=True)
                ]
            )

        return wait

    def _queue(
        self,
        size: int,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> "Outcome":
        """Fill up to a size that is compiled, with trials that run no step."""
        rows = np.minimum(np.arange(size), len(index) - 1)
        steps = np.where(np.arange(size) < len(index), count[rows], 0).astype(np.int32)
        split, whole = by_trial(self.mesh), on_each(self.mesh)
        qpos, qvel = _parts(state[rows])
        with jax.enable_x64(self.double):

            def run() -> Outcome:
                number = _put(index[rows].astype(np.int32), self.double, split)
                trials = _put((qpos, qvel, control[rows]), self.double, split)
                ends = _put(steps, self.double, split)
                push = _put(np.array(force), self.double, whole)
                found: Outcome = compiled_chunk(self.shape, self.mesh)(
                    self.rig, self.bodies, number, *trials, push, ends
                )
                return found

            return _guarded(run)

    def _fetch(
        self, found: "Outcome", state: Float[Array, "n d"], count: Int[Array, "n"]
    ) -> Stretch:
        """Wait for a call, and hand back its numbers without those that filled it up."""

        def host(values: Any) -> Array:
            array = np.asarray(values)[: len(state)]
            return array.astype(float) if array.dtype.kind == "f" else array

        time = state[:, :1] + self.timestep * count[:, None]
        return Stretch(
            state=np.concatenate([time, host(found.qpos), host(found.qvel)], axis=1),
            qpos_at_sensors=host(found.qpos_at_sensors),
            sensors=host(found.sensors),
            failed=host(found.failed),
            overflowed=host(found.overflowed),
            steps=Digest(**{name: host(value) for name, value in found.steps.items()}),
        )


def open_worlds(models: Sequence[GraspModel], *, capacity: int, config: TrialConfig) -> JaxWorlds:
    """Room for so many trials of these objects, all of one bucket, on all of JAX's devices."""
    del config  # all of it is in the models
    return JaxWorlds(models, capacity=capacity)


def suggested_capacity(models: Sequence[GraspModel]) -> int | None:
    """Trials side by side that the devices' free memory has room for; None if unknown."""
    room = 0
    for one in jax.devices():
        stats = one.memory_stats()
        if not stats or "bytes_limit" not in stats:
            return None
        room += stats["bytes_limit"] - stats.get("bytes_in_use", 0)
    most = max(bytes_a_trial(model) for model in models)
    return max(1, int(_MEMORY_SHARE * room / most))


def bytes_a_trial(model: GraspModel) -> int:
    """Device memory that a trial takes while it runs, about."""
    bounds = bucket(model)
    return (
        _pairs(model, bounds) * bounds.edges * _BYTES_AN_EDGE + bounds.hulls * bounds.corners * 16
    )


def device() -> str:
    """Versions and the devices, as records name them."""
    found = jax.devices()
    several = f"{len(found)} x " if len(found) > 1 else ""
    version = importlib.metadata.version("jax")
    return f"gmdx's own step, jax {version} on {several}{found[0].device_kind}"


def _parts(state: Float[Array, "n d"]) -> tuple[Float[Array, "n q"], Float[Array, "n v"]]:
    positions = HEIGHT_QPOS + 3
    return state[:, 1 : 1 + positions], state[:, 1 + positions :]


def _sizes(capacity: int, devices: int, platform: str) -> tuple[int, ...]:
    """Batch sizes that are compiled, ascending, each a multiple of the devices."""
    wanted = {_PIECE} if platform == "cpu" else {capacity, -(-capacity // _SMALLER)}
    return tuple(sorted({-(-size // devices) * devices for size in wanted}))


def _pairs(model: GraspModel, bounds: Bucket) -> int:
    m = model.model
    boxes = int(np.sum((m.geom_bodyid != 0) & (m.geom_bodyid != model.object_body)))
    return min(boxes * bounds.hulls, _MOST_PAIRS[bounds.hulls])


def _shape(model: GraspModel, bounds: Bucket) -> Shape:
    layout, option = model.sensors, model.model.opt
    pairs = _pairs(model, bounds)
    return Shape(
        pairs=pairs,
        contacts=min(_CONTACTS, 4 * pairs),
        on_table=min(_ON_TABLE, 4 * bounds.hulls),
        iterations=int(option.iterations),
        line_iterations=int(option.ls_iterations),
        places=(
            *(int(pad.start) for pad in layout.pads),
            *(layout.hand, layout.hand_table, layout.object_table),
        ),
        slots=layout.slots,
        sensors=int(model.model.nsensordata),
    )


def _put(tree: Any, double: bool, sharding: NamedSharding) -> Any:
    """Copies on the devices, floats in the precision of the step."""
    kind = np.float64 if double else np.float32

    def one(value: Any) -> Any:
        array = np.array(value, dtype=kind if np.asarray(value).dtype.kind == "f" else None)
        return jax.device_put(array, sharding)

    return jax.tree.map(one, tree)


def _guarded(compute: Callable[[], _T]) -> _T:
    """Name the want of memory as such.

    Raises:
        DeviceMemoryError: XLA says that its resources are exhausted.
    """
    try:
        return compute()
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise DeviceMemoryError(f"JAX's device is out of memory: {str(error)[:200]}") from error
