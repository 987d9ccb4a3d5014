"""Pages are well-formed, keep text text, and round no more than they should."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from gmdx.pictures.figure import DrawConfig, new_figure
from gmdx.pictures.page import number, p_value, page, percent, picture, table


def test_a_page_is_well_formed_and_escapes_what_is_text() -> None:
    figure = new_figure(DrawConfig(width=40, height=30))
    body = [
        table(["<a>", "n & m"], [["x < y", "1"], ["z", "2"]], faint=[1]),
        picture("dots", figure, "a caption: 1 < 2"),
    ]
    text = page("A & B", body)
    root = ElementTree.fromstring(_closed(text.removeprefix("<!DOCTYPE html>\n")))
    assert root.findtext("head/title") == "A & B"
    assert [cell.text for cell in root.iter("th")] == ["<a>", "n & m"]
    assert [cell.text for cell in root.iter("td")] == ["x < y", "1", "z", "2"]
    assert [row.get("class") for row in root.iter("tr")] == [None, None, "faint"]
    assert root.findtext(".//figcaption") == "a caption: 1 < 2"
    (image,) = root.iter("img")
    assert str(image.get("src")).startswith("data:image/png;base64,iVBOR")


def _closed(text: str) -> str:
    """HTML with its void elements closed, as XML wants them."""
    return re.sub(r"<(img|meta) ([^>]*)>", r"<\1 \2/>", text)


def test_only_long_cells_of_words_may_break() -> None:
    root = ElementTree.fromstring(table(["a", "b"], [["word " * 30, "1"], ["short", "2"]]))
    assert [cell.get("class") for cell in root.iter("td")] == ["w p", "n", "w", "n"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.2345, "1.23"), (-0.5, "-0.5"), (1234.5, "1234"), (1.24e-4, "1.2e-04"),
     (5e-4, "0.0005"), (np.nan, "-"), (-np.inf, "-")],
)  # fmt: skip
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


def test_percentages_and_p_values() -> None:
    assert [percent(v) for v in (0.0, 0.1234, 1.0, np.nan)] == ["0.0", "12.3", "100.0", "-"]
    values = (0.03, 1e-4, 9.9e-5, np.nan)
    assert [p_value(v) for v in values] == ["0.0300", "0.0001", "< 0.0001", "-"]
