"""Figures as tables."""

import dataclasses
import json
import math
from collections.abc import Sequence
from typing import Any

from rich.table import Table

from gmdx.cli.terminal import console, say


def show_records(title: str, found: Sequence[Any], *, as_json: bool, upright: bool = False) -> None:
    """Records of figures as a table, a row each (upright: a column each), or as JSON."""
    values = [dataclasses.asdict(item) for item in found]
    if as_json:
        say(json.dumps(values, indent=1))
        return
    rows = [[name.replace("_", " ") for name in values[0]]]
    rows += [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()]
             for row in values]  # fmt: skip
    if upright:
        rows = [list(row) for row in zip(*rows, strict=True)]
    table = Table(title=title)
    for column, name in enumerate(rows[0]):
        table.add_column(name, justify="left" if upright and column == 0 else "right")
    for row in rows[1:]:
        table.add_row(*row)
    console().print(table)


def short(value: float) -> str:
    """The digits that matter; large numbers in thousands or millions."""
    if math.isnan(value):
        return "-"
    if value >= 1e7:
        return f"{value / 1e6:,.0f} M"
    if value >= 1e5:
        return f"{value / 1e3:,.0f} k"
    if value >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}" if value >= 1 else f"{value:.2g}"
