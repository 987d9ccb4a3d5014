"""Where two fingers first touch a surface, along lines parallel to the closing axis."""

from gmdx_kernels.closing_lines.api import closing_lines, pad_grid
from gmdx_kernels.closing_lines.touches import FirstTouch

__all__ = ["FirstTouch", "closing_lines", "pad_grid"]
