"""What the README says is what the code does."""

import re
from pathlib import Path

import numpy as np
import trimesh

from gmdx.metrics.table import METRICS

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_table_of_metrics_is_the_declared_one() -> None:
    listed = re.findall(r"^\| (\d+) \| `(\w+)` \| (\w+) \| (\S+) \| (.+) \|$", README, re.MULTILINE)
    declared = [
        (str(m.number), m.name, m.kind, m.unit if m.unit else "-", m.definition) for m in METRICS
    ]
    assert listed == declared


def test_the_python_example_runs(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.+?)```", README, re.DOTALL)
    before, _ = code.split("dataset =")
    mesh = trimesh.creation.cylinder(radius=0.02, height=0.06)
    mesh.export(tmp_path / "mug.obj")
    names: dict[str, object] = {}
    exec(before.replace('"mug.obj"', repr(str(tmp_path / "mug.obj"))), names)
    table = names["table"]
    assert np.isfinite(table["bound_l"]).all()  # type: ignore[index]
    assert len(table) == 64  # type: ignore[arg-type]


def test_pictures_are_there() -> None:
    for picture in re.findall(r"!\[.+?\]\((.+?)\)", README):
        assert (Path(__file__).parents[1] / picture).is_file()
