"""Arguments of the public functions, checked and named before anything is computed."""

from typing import Any

import numpy as np

from gmdx.arrays import Array
from gmdx.errors import MetricError

_FAR = 1e12


def as_floats(value: Any, name: str) -> Array:
    """An array of floats.

    Raises:
        MetricError: `value` is not an array of real numbers.
    """
    try:
        kind = np.asarray(value).dtype.kind
        if kind not in "iufO":
            raise TypeError(f"its type is {np.asarray(value).dtype}")
        array: Array = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise MetricError(f"{name} must be an array of numbers: {error}") from error
    return array


def as_float(value: Any, name: str) -> float:
    """One float.

    Raises:
        MetricError: `value` is not a real number.
    """
    array = as_floats(value, name)
    if value is None or array.shape != ():
        raise MetricError(f"{name} must be one number, not {value!r}")
    return float(array)


def as_count(value: Any, name: str) -> int:
    """A whole number of at least 0.

    Raises:
        MetricError: `value` is none.
    """
    number = as_float(value, name)
    if not (number >= 0 and number % 1 == 0):
        raise MetricError(f"{name} must be a whole number of at least 0, not {value}")
    return int(number)


def check_proportions(
    points: Array, *, friction: float, torsion: float, torque_scale: float, origin: Array
) -> None:
    """Refuse numbers that lie so far apart that nothing can be computed from them.

    Raises:
        MetricError: Naming the argument.
    """
    with np.errstate(over="ignore"):
        reach = np.abs(points - origin).max() / torque_scale
        sizes = {"points": reach, "friction": friction, "torsion": torsion / torque_scale}
    for name, size in sizes.items():
        if not size <= _FAR:
            raise MetricError(
                f"{name} must not be {size:.3g} times the unit (of lengths: torque_scale,"
                f" {torque_scale:.3g} m): at most {_FAR:.0e}. Are all lengths in metres?"
            )
