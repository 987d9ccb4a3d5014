"""Convex hulls in place of a closed surface, as few as represent it, and how well they do.

`decompose` asks CoACD (in a process of its own), then merges, trims and simplifies hulls as long
as they stay close enough to the surface.
"""

from gmdx.objects.decompose.decomposition import Attempt, DecomposeConfig, decompose

__all__ = [
    "Attempt",
    "DecomposeConfig",
    "decompose",
]
