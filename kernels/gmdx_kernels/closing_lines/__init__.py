"""Where two fingers first touch a surface, along lines parallel to the closing axis."""

from gmdx_kernels.closing_lines.reference import FirstTouch, closing_lines, pad_grid

__all__ = ["FirstTouch", "closing_lines", "pad_grid"]
