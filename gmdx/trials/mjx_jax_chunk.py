"""The steps of a chunk of many trials, compiled as a whole."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from gmdx.trials.frames import digest_fields
from gmdx.trials.mjx_jax_constraints import Moment, Shape
from gmdx.trials.mjx_jax_rig import Body, Rig
from gmdx.trials.mjx_jax_step import step


class Outcome(NamedTuple):
    """What a call leaves on the device."""

    qpos: Any  # (n 10)
    qvel: Any  # (n 9)
    qpos_at_sensors: Any  # (n 10)
    sensors: Any  # (n d)
    failed: Any  # (n) bool
    overflowed: Any  # (n) bool
    steps: Any  # of `Digest`, by name, (n s ...)


def by_trial(mesh: Mesh) -> NamedSharding:
    """Arrays whose first axis, over trials, is split over the devices."""
    spec: Any = PartitionSpec  # untyped in JAX
    return NamedSharding(mesh, spec(*mesh.axis_names))


def on_each(mesh: Mesh) -> NamedSharding:
    """Arrays that every device has whole."""
    spec: Any = PartitionSpec
    return NamedSharding(mesh, spec())


@functools.lru_cache(maxsize=64)
def compiled_chunk(shape: Shape, mesh: Mesh) -> Callable[..., Outcome]:
    """The steps of a chunk, compiled once for each batch size."""
    run = functools.partial(_chunk, shape=shape)
    if mesh.size > 1:  # each device runs loops of its own, and waits for no other
        split, whole = by_trial(mesh).spec, on_each(mesh).spec
        inputs = (whole, whole, split, split, split, split, whole, split)
        run = jax.shard_map(run, mesh=mesh, in_specs=inputs, out_specs=split, check_vma=False)
    compiled: Callable[..., Outcome] = jax.jit(run)
    return compiled


def _chunk(
    rig: Rig,
    bodies: Body,
    number: jax.Array,
    qpos: jax.Array,
    qvel: jax.Array,
    control: jax.Array,
    push: jax.Array,
    count: jax.Array,
    *,
    shape: Shape,
) -> Outcome:
    """Steps of n trials; each stays as it is after its last one."""
    every = jax.vmap(functools.partial(step, shape=shape), in_axes=(None, None, 0, 0, 0, None))

    def one(carry: Any, item: Any) -> tuple[Any, Any]:
        now, before, sensors, failed, overflowed = carry
        order, controls, force = item
        after, seen = every(rig, bodies, number, now, controls, force)
        steps = digest_fields(after.qpos, after.qvel, seen.sensors, shape.layout)
        runs = (order < count) & ~failed
        well = jnp.isfinite(after.qpos).all(axis=1) & jnp.isfinite(after.qvel).all(axis=1)

        def kept(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where((runs & well)[:, None], new, old)

        carry = (
            jax.tree.map(kept, after, now),
            kept(now.qpos, before),
            kept(seen.sensors, sensors),
            failed | (runs & ~well),
            overflowed | (runs & seen.overflowed),
        )
        return carry, steps

    begin = (
        Moment(qpos, qvel, jnp.zeros_like(qvel)),
        qpos,
        jnp.zeros((len(qpos), shape.sensors), qpos.dtype),
        jnp.zeros(len(qpos), bool),
        jnp.zeros(len(qpos), bool),
    )
    items = jnp.arange(control.shape[1]), jnp.moveaxis(control, 1, 0), push
    carry, steps = jax.lax.scan(one, begin, items)
    now, before, sensors, failed, overflowed = carry
    steps = {name: jnp.moveaxis(value, 0, 1) for name, value in steps.items()}
    return Outcome(now.qpos, now.qvel, before, sensors, failed, overflowed, steps)
