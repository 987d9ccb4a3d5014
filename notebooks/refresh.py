"""Run notebooks from their texts and store them with what they show.

`python notebooks/refresh.py` does it for every text in this folder, `... epsilon.md` for one.
The picture of a cell tagged `readme` is also stored as docs/NOTEBOOK.png, which README.md shows.
The text is what one edits; `jupytext --sync` takes edits made in Jupyter back to it.
"""

import base64
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

DOCS = Path(__file__).parents[1] / "docs"


def refresh(text: Path) -> Path:
    """Run one text, write the notebook beside it, and return the notebook's path."""
    notebook = jupytext.read(text)
    for i, cell in enumerate(notebook.cells):
        cell["id"] = f"{text.stem}-{i}"  # the same from run to run
    # Where it is run stands the code that serves it alone.
    there = {"metadata": {"path": str(text.resolve().parent)}}
    NotebookClient(
        notebook, timeout=600, kernel_name="python3", record_timing=False, resources=there
    ).execute()
    shared = ("jupytext", "kernelspec", "language_info")
    notebook.metadata = {name: notebook.metadata[name] for name in shared}
    del notebook.metadata["language_info"]["version"]  # another Python shows the same
    notebook.metadata["jupytext"] = {"formats": "ipynb,md:myst"}
    path = text.with_suffix(".ipynb")
    nbformat.write(notebook, path)
    for cell in notebook.cells:
        if "readme" in cell.metadata.get("tags", []):
            picture = base64.b64decode(cell.outputs[-1].data["image/png"])
            (DOCS / f"{text.stem}.png").write_bytes(picture)
    return path


if __name__ == "__main__":
    folder = Path(__file__).parent
    for name in sys.argv[1:] or sorted(path.name for path in folder.glob("*.md")):
        sys.stdout.write(f"{refresh(folder / name).name}\n")
