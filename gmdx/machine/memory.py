"""Memory of this process."""

import ctypes


def return_freed_memory() -> None:
    """Hand memory that was freed back to the system.

    The GNU allocator keeps it in pieces between what lives on, and grows with every batch of
    large arrays; other allocators have no such call, nor the need for it.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
