"""Everyday objects made by code: solids.py builds closed surfaces, shapes.py the objects."""

from gmdx_assets.parametric.shapes import SHAPES
from gmdx_assets.parametric.solids import Solid

__all__ = ["SHAPES", "Solid"]
