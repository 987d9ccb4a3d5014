"""What the pictures share: their configuration, an empty figure, saving, the metric by name."""

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gmdx.errors import UsageError
from gmdx.metrics.table import METRICS, Metric

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "0.15"


@dataclass(frozen=True)
class DrawConfig:
    """How pictures look."""

    width: int = 1200  # pixels
    height: int = 900  # pixels
    dpi: int = 100
    colormap: str = "plasma"  # of matplotlib, for the metric
    pad_width: float = 0.02  # m, of a pad's face across the closing axis
    crop: bool = True  # show what is around the object and the grasps, not the whole image
    most: int | None = 20  # grasps drawn at most, spread over places and angles; None: all

    def __post_init__(self) -> None:
        if self.most is not None and self.most < 1:
            raise UsageError(f"cannot draw at most {self.most} grasps: give 1 or more")


def metric_named(name: str) -> Metric:
    """The metric of that name.

    Raises:
        UsageError: There is none.
    """
    known = {metric.name: metric for metric in METRICS}
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        raise UsageError(f"no metric '{name}'{hint}: there are {', '.join(known)}")
    return known[name]


def check_colormap(name: str) -> None:
    """Refuse a colour map that matplotlib does not have.

    Raises:
        UsageError: There is none of that name.
    """
    from matplotlib import colormaps

    if name not in colormaps:
        known = sorted(known for known in colormaps if not known.endswith("_r"))
        raise UsageError(f"no colour map '{name}': there are {', '.join(known)}")


def with_unit(metric: Metric) -> str:
    """The metric's name, and its unit if it has one, for an axis or a colour bar."""
    return f"{metric.name} ({metric.unit})" if metric.unit else metric.name


def new_figure(config: DrawConfig) -> "Figure":
    """An empty white figure that belongs to no window and no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = (config.width / config.dpi, config.height / config.dpi)
    figure = Figure(figsize=size, dpi=config.dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Write a figure; the name's ending (png, pdf, svg, ...) says in which format.

    Raises:
        UsageError: The format is unknown, or the file cannot be written.
    """
    path = Path(path)
    known = figure.canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in known:
        raise UsageError(f"cannot draw into {path}: the name must end in {', '.join(known)}")
    try:
        figure.savefig(path, dpi=figure.dpi)
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error
