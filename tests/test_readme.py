"""What the README says is what the code does."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import gmdx
from gmdx.metrics.table import METRICS
from tests.dataset.hand_built import write_dataset

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_table_of_metrics_is_the_declared_one() -> None:
    listed = re.findall(r"^\| (\d+) \| `(\w+)` \| (\w+) \| (\S+) \| (.+) \|$", README, re.MULTILINE)
    declared = [
        (str(m.number), m.name, m.kind, m.unit if m.unit else "-", m.definition) for m in METRICS
    ]
    assert listed == declared


EXAMPLES = re.findall(r"```python\n(.+?)```", README, re.DOTALL)


def test_the_python_example_runs(tmp_path: Path) -> None:
    before, _ = EXAMPLES[0].split("dataset =")
    mesh = trimesh.creation.cylinder(radius=0.02, height=0.06)
    mesh.export(tmp_path / "mug.obj")
    names: dict[str, object] = {}
    exec(before.replace('"mug.obj"', repr(str(tmp_path / "mug.obj"))), names)
    table = names["table"]
    assert np.isfinite(table["bound_l"]).all()  # type: ignore[index]
    assert len(table) == 64  # type: ignore[arg-type]


def test_the_pinch_has_the_strength_that_the_example_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    exec(EXAMPLES[1], {})
    first, second = capsys.readouterr().out.splitlines()
    lower, upper = (float(word) for word in first.split()[:2])
    assert lower <= upper == pytest.approx(0.04, rel=1e-6)
    # Both fingers pull straight up with 0.8 x 20 N.
    assert float(second) == pytest.approx(2 * 0.8 * 20 / (0.1 * 9.81), rel=1e-6)


def test_labels_and_images_of_a_dataset_as_the_example_says(tmp_path: Path) -> None:
    write_dataset(tmp_path / "runs", "mug", "bowl")
    names: dict[str, object] = {"gmdx": gmdx}
    exec(EXAMPLES[2].replace("runs/demo", str(tmp_path / "runs")), names)
    assert names["dataset"].label_tables == ("all_trials",)  # type: ignore[attr-defined]


def test_pictures_are_there() -> None:
    for picture in re.findall(r"!\[.+?\]\((.+?)\)", README):
        assert (Path(__file__).parents[1] / picture).is_file()
