"""Every notebook runs, says and shows what it should, and is the same as its text.

After a change of a text, `python notebooks/refresh.py` runs it and stores the notebook.
"""

import base64
import json
import re
from pathlib import Path
from typing import Any

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
DOCS = FOLDER.parent / "docs"
LARGEST = 1_000_000  # bytes, pictures included
LARGEST_PICTURE = 200_000  # bytes, of one in docs
PLACES = re.compile(r"(?<![\w.])/(?:home|root|tmp|usr|work|opt|var|mnt|private|Users)/|[A-Z]:\\\\")

each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def failures(notebook: Any) -> list[str]:
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return [
        str(output.get("evalue", output.get("text")))
        for output in outputs
        if output.output_type == "error" or output.get("name") == "stderr"
    ]


def pictures(notebook: Any) -> int:
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return sum("image/png" in output.get("data", {}) for output in outputs)


def printed(notebook: Any) -> list[str]:
    """What each cell wrote to its standard output."""
    return [
        "".join(o.text for o in cell.outputs if o.get("name") == "stdout")
        for cell in code_cells(notebook)
    ]


def test_there_are_notebooks_and_each_has_its_text() -> None:
    assert NOTEBOOKS
    assert [p.stem for p in NOTEBOOKS] == sorted(p.stem for p in FOLDER.glob("*.md"))


@each
def test_notebook_and_text_are_the_same(path: Path) -> None:
    notebook, text = jupytext.read(path), jupytext.read(path.with_suffix(".md"))
    for one in (notebook, text):
        assert one.metadata["jupytext"]["formats"] == "ipynb,md:myst"
        assert one.metadata["kernelspec"]["name"] == "python3"
    cells = [
        [(cell.cell_type, cell.source.strip()) for cell in one.cells] for one in (notebook, text)
    ]
    assert cells[0] == cells[1]


@each
def test_what_is_committed_has_been_run(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    counts = [cell.execution_count for cell in code_cells(notebook)]
    assert counts == list(range(1, len(counts) + 1))  # once, from top to bottom
    assert not failures(notebook)
    assert pictures(notebook) > 0


@each
def test_what_is_committed_is_small_and_names_no_machine(path: Path) -> None:
    assert path.stat().st_size < LARGEST
    notebook = json.loads(path.read_text())
    for cell in notebook["cells"]:
        assert set(cell["metadata"]) <= {"tags"}, "times of execution do not belong there"
        for output in cell.get("outputs", []):
            output.get("data", {}).pop("image/png", None)
    assert not PLACES.search(json.dumps(notebook))


@each
def test_it_runs(path: Path) -> None:
    if "bullet" in path.with_suffix(".md").read_text().lower():
        pytest.importorskip("pybullet", reason="the second engine is not installed")
    kept, notebook = read(path), read(path)
    for cell in code_cells(notebook):
        cell.outputs, cell.execution_count = [], None
    there = {"metadata": {"path": str(FOLDER)}}  # beside the code that serves it alone
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=there).execute()
    assert not failures(notebook)
    assert pictures(notebook) == pictures(kept)
    assert printed(notebook) == printed(kept)  # numbers with as few digits as all machines share


@each
def test_the_picture_of_the_readme_is_the_notebooks(path: Path) -> None:
    tagged = [c for c in code_cells(read(path)) if "readme" in c.metadata.get("tags", [])]
    assert len(tagged) <= 1
    for cell in tagged:
        shown = (DOCS / f"{path.stem}.png").read_bytes()
        assert shown == base64.b64decode(cell.outputs[-1].data["image/png"])
        assert len(shown) < LARGEST_PICTURE
