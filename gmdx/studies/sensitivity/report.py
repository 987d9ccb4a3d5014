"""A sensitivity study as one HTML file that opens without a network."""

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from gmdx.pictures import page

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

_HOW = {
    "morris": (
        "Morris' method: each block is a trajectory on which one parameter after the other "
        "moves. <b>mu*</b> is the mean absolute effect of the whole range, in the output's unit; "
        "<b>mu</b> the mean effect with its sign; <b>sigma</b> the effects' standard deviation: "
        "large against mu* where the effect depends on the other parameters."
    ),
    "sobol": (
        "Sobol's method on Saltelli's scheme: each block is one of its rows. <b>ST</b> is the "
        "share of the output's variance that involves the parameter, <b>S1</b> what it explains "
        "alone; the rest is interaction."
    ),
    "oat": (
        "One at a time: each parameter goes through its range while the others stay at their "
        "default. <b>swing</b> is the largest minus the smallest value, <b>end to end</b> the "
        "value at the range's end minus that at its start. Interactions are not seen."
    ),
}
_TITLES = {
    "morris": "mu*: mean absolute effect of a parameter's whole range",
    "sobol": "ST: share of the variance that involves a parameter",
    "oat": "largest minus smallest value over a parameter's range",
}
_NAMES = {"morris": ("mu*", "mu"), "sobol": ("ST", "S1"), "oat": ("swing", "end to end")}
_BLOCKS = {"morris": "trajectories", "sobol": "rows", "oat": "parameters"}


def report(result: Mapping[str, Any], figures: Mapping[str, "Figure"]) -> str:
    """The report.

    Args:
        result: What `sensitivity.json` holds.
        figures: By name, as the study drew them.
    """
    counts = result["counts"]
    failures = "".join(
        f"<li>{escape(name)}: {escape(why)}</li>" for name, why in result["failures"].items()
    )
    body = [
        "<h1>What the labels depend on</h1>",
        f"<p>{escape(', '.join(result['objects']))}: {result['runs_per_object']} runs of each, "
        f"{counts['trials']:,} trials in all, {counts['diverged']:,} of which diverged. The "
        "scenes and grasps are the same in all runs, settled and sampled at the defaults; only "
        "the trials change.</p>",
        f"<p>{_HOW[result['method']]}</p>",
        "<p>The parameter <b>seed</b> redraws the pose noise and moves grasps by 10 micrometres: "
        "what it does is chance. Rows in grey are not clearly above it.</p>",
        *([f"<p>Objects left out:</p><ul>{failures}</ul>"] if failures else []),
        *(_section(result, output, figures) for output in result["outputs"].values()),
        "<h2>Parameters</h2>",
        _parameters(result),
    ]
    return page.page("gmdx sensitivity", body)


def table(result: Mapping[str, Any]) -> "Table":
    """How much each output depends on each parameter, for a terminal.

    Args:
        result: What `sensitivity.json` holds.
    """
    from rich.table import Table

    outputs = list(result["outputs"].values())
    made = Table(title=f"{_TITLES[result['method']]}; * above chance, which is what seed does")
    made.add_column("parameter")
    for output in outputs:
        unit = f" ({output['unit']})" if output["unit"] and result["method"] != "sobol" else ""
        made.add_column(f"{output['name']}{unit}", justify="right")
    found = [output["indices"]["all objects"] for output in outputs]
    for parameter in result["parameters"]:
        cells = []
        for one in found:
            values = one["parameters"][parameter["name"]]
            mark = " *" if values["above_noise"] else "  "
            cells.append(_interval(values["total"], values["total_half"]) + mark)
        made.add_row(parameter["name"], *cells)
    made.add_section()
    made.add_row(f"{_BLOCKS[result['method']]} used", *(f"{one['blocks']}  " for one in found))
    left_out = [output["object_blocks_left_out"] for output in outputs]
    if any(left_out):
        made.add_row("left out, of objects", *(f"{count}  " for count in left_out))
    return made


def _ranked(found: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Parameters with their indices, the largest total first, unknown ones last."""
    return sorted(
        found["parameters"].items(), key=lambda item: -np.nan_to_num(item[1]["total"], nan=-1.0)
    )


def _section(
    result: Mapping[str, Any], output: Mapping[str, Any], figures: Mapping[str, "Figure"]
) -> str:
    name, found = output["name"], output["indices"]["all objects"]
    unit = f", {output['unit']}" if output["unit"] else ""
    missing, blocks = output["runs_without_value"], _BLOCKS[result["method"]]
    notes = [f"All {found['blocks']} {blocks} used."]
    if missing:
        pairs = output["object_blocks_left_out"]
        notes = [
            f"{missing} of {result['runs']} runs have no value, so {pairs} of "
            f"{len(result['objects']) * result['blocks']} {blocks} of an object are left out; "
            f"{found['blocks']} of {result['blocks']} remain for all objects together."
        ]
    if name == "force" and result["counts"]["lower_bounds"]:
        notes.append(
            f"{result['counts']['lower_bounds']:,} of {result['counts']['held']:,} forces are "
            "lower bounds: the push ended first."
        )
    baseline = ", ".join(f"{escape(k)} {page.number(v)}" for k, v in output["baseline"].items())
    pictures = "".join(
        page.picture(key, figure) for key, figure in figures.items() if key.endswith(f"_{name}")
    )
    return (
        f"<h2>{escape(name)}</h2><p>{escape(output['definition'])}{unit}. At the defaults: "
        f"{baseline}. {' '.join(notes)}</p>{pictures}{_indices(result['method'], found)}"
    )


def _indices(method: str, found: Mapping[str, Any]) -> str:
    ranked = _ranked(found)
    with_spread = method == "morris"
    rows = [
        [
            name,
            _interval(values["total"], values["total_half"]),
            _interval(values["main"], values["main_half"]),
            *([page.number(values["spread"])] if with_spread else []),
        ]
        for name, values in ranked
    ]
    head = ["parameter", *_NAMES[method], *(["sigma"] if with_spread else [])]
    noise = [k for k, (_, values) in enumerate(ranked) if not values["above_noise"]]
    return page.table(head, rows, faint=noise)


def _parameters(result: Mapping[str, Any]) -> str:
    rows = [
        [p["name"], p["unit"], *(page.number(p[key]) for key in ("low", "default", "high")),
         p["scale"], p["reason"]]
        for p in result["parameters"]
    ]  # fmt: skip
    head = ["parameter", "unit", "from", "default", "to", "scale", "reason for the range"]
    return page.table(head, rows, words=(0, 1, 5, 6))


def _interval(value: float, half: float) -> str:
    return page.number(value) + (f" ± {page.number(half)}" if np.isfinite(half) else "")
