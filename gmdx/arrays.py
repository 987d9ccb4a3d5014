"""Array annotations: dtype and shape in the signature, checked under test.

`Float[Array, "n 3"]` is an array of floats of shape (n, 3). Under test every
annotation is enforced (jaxtyping with beartype); in use they cost nothing.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

if TYPE_CHECKING:
    Array = np.ndarray[Any, np.dtype[Any]]
else:
    Array = np.ndarray

__all__ = ["Array", "Bool", "Float", "Int", "UInt8"]
