"""From a mesh file to a surface that physics can use, with every step recorded.

`read_mesh` reads a file of one of the `FORMATS`; `repair` merges, turns, closes, thickens and
simplifies it, a module a step.
"""

from gmdx.objects.repair.read import FORMATS, as_trimesh, read_mesh
from gmdx.objects.repair.repairing import RepairConfig, RepairedMesh, repair

__all__ = [
    "FORMATS",
    "RepairConfig",
    "RepairedMesh",
    "as_trimesh",
    "read_mesh",
    "repair",
]
