"""A report as one HTML page that opens without a network: its style, tables, figures, numbers."""

import base64
import io
from collections.abc import Collection, Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1240px;
  margin: 2em auto; padding: 0 1.2em }
h1 { font-size: 1.6em } h2 { font-size: 1.25em; margin-top: 2.2em }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 0.83em; margin: 0.8em 0 }
th, td { padding: 0.25em 0.7em; border-bottom: 1px solid #e2e2e2; vertical-align: bottom }
th { border-bottom: 1.5px solid #888; font-weight: 600; max-width: 11em }
.w { text-align: left } .n { text-align: right; font-variant-numeric: tabular-nums }
td { white-space: nowrap } td.p { white-space: normal }
tbody tr:nth-child(even) { background: #f7f7f7 }
tr.faint { color: #999 }
figure { margin: 1.2em 0 } img { max-width: 100% }
figcaption { font-size: 0.88em; color: #555; max-width: 60em }
details { margin: 0.4em 0 } summary { cursor: pointer }
"""
_PROSE = 60  # characters of a cell beyond which it may be broken into lines


def page(title: str, body: Iterable[str]) -> str:
    """The whole file.

    Args:
        title: As text.
        body: HTML, a part a line.
    """
    text = "\n".join(body)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body>\n{text}\n</body></html>\n"
    )


def picture(name: str, figure: "Figure", caption: str = "") -> str:
    """A figure inside the page.

    Args:
        name: By which a link can find it.
        figure: Which.
        caption: As text.
    """
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=figure.dpi, metadata={"Software": None})
    data = base64.b64encode(file.getvalue()).decode("ascii")
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    image = f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'
    return f'<figure id="{escape(name)}">{image}{text}</figure>'


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    words: Collection[int] = (0,),
    faint: Collection[int] = (),
) -> str:
    """A table.

    Args:
        head: A column's title each, as text.
        rows: Cells, as text.
        words: Which columns hold words; the others hold numbers.
        faint: Which rows are shown in grey.
    """
    inside = "\n".join(_row(cells, "td", words, faint=k in faint) for k, cells in enumerate(rows))
    return (
        f'<div class="wide"><table><thead>{_row(head, "th", words)}</thead>'
        f"<tbody>\n{inside}\n</tbody></table></div>"
    )


def _row(cells: Sequence[str], tag: str, words: Collection[int], *, faint: bool = False) -> str:
    items = []
    for k, cell in enumerate(cells):
        kind = ("w p" if len(cell) > _PROSE else "w") if k in words else "n"
        items.append(f'<{tag} class="{kind}">{escape(cell)}</{tag}>')
    start = '<tr class="faint">' if faint else "<tr>"
    return f"{start}{''.join(items)}</tr>"


def number(value: float) -> str:
    """Three significant digits; "-" for what does not exist."""
    if not np.isfinite(value):
        return "-"
    if value != 0 and abs(value) < 5e-4:
        return f"{value:.1e}"
    return "0" if value == 0 else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(share: float) -> str:
    """A share in per cent, one decimal."""
    return f"{100 * share:.1f}" if np.isfinite(share) else "-"


def p_value(value: float) -> str:
    """A p value; no more than says something."""
    if not np.isfinite(value):
        return "-"
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"
