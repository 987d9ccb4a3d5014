import re
from pathlib import Path

import pytest

from gmdx.metrics.table import METRIC_NAMES, METRICS

DESIGN = Path(__file__).parents[2].parent / "shared" / "design.md"


def test_numbers_run_from_0_to_35_without_gap() -> None:
    assert [metric.number for metric in METRICS] == list(range(36))
    assert len(set(METRIC_NAMES)) == 36
    assert tuple(metric.name for metric in METRICS) == METRIC_NAMES


def test_normalised_metrics_stand_beside_what_they_normalise() -> None:
    by_name = {metric.name: metric for metric in METRICS}
    normalised = [metric for metric in METRICS if metric.name.endswith("_norm")]
    assert [m.number for m in normalised] == [5, 9, 11, 14, 17, 19, 21, 27, 29, 33]
    for metric in normalised:
        base = by_name[metric.name.removesuffix("_norm")]
        assert base.unit == "m"
        assert metric.unit == ""
        assert (metric.kind, metric.stage) == (base.kind, base.stage)


def test_every_metric_says_what_it_is() -> None:
    for metric in METRICS:
        assert metric.definition
        assert metric.unit in {"", "m", "rad", "N"}


@pytest.mark.skipif(not DESIGN.exists(), reason="the design is not beside this checkout")
def test_names_numbers_and_kinds_are_those_of_the_design() -> None:
    expected: dict[int, tuple[str, str]] = {}
    rows = re.findall(
        r"^\| ([\d, ]+) \| ([a-z_, ]+) \| (priori|posteriori|comparative) \|",
        DESIGN.read_text(),
        re.MULTILINE,
    )
    for numbers, names, kind in rows:
        full = [name.strip() for name in names.split(",")]
        full = [full[0] + name if name == "_norm" else name for name in full]
        for number, name in zip(numbers.split(","), full, strict=True):
            expected[int(number)] = (name, kind)
    assert len(expected) == 36
    assert {m.number: (m.name, m.kind) for m in METRICS} == expected
