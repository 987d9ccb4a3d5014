"""What patches add to the pair of their means, on shapes where it is known."""

import json
from pathlib import Path

import numpy as np
import pytest

from gmdx.cli.main import main
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.gripper import load_gripper
from gmdx.studies.epsilon.patches import means, patch_figures
from tests.runs import write_meshes
from tests.support import box_object, resting_scene


def test_the_mean_of_a_patch_stands_for_it() -> None:
    points = np.array([[[[0.0, 0, 0], [0, 2, 0]], [[1, 0, 0], [9, 9, 9]]]])
    normals = np.array([[[[1.0, 0, 0], [0, 1, 0]], [[-1, 0, 0], [0, 0, 1]]]])
    valid = np.array([[[True, True], [True, False]]])
    found = means(PadContacts(points, normals, valid))
    np.testing.assert_allclose(found.points[0, :, 0], [[0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(found.normals[0, :, 0], [[0.5**0.5, 0.5**0.5, 0], [-1, 0, 0]])
    assert found.valid.all()


def test_flat_patches_resist_more_than_their_means() -> None:
    """The mean of a flat patch is one of its points, and a patch adds lever arms to it."""
    scenes = [resting_scene(box_object((0.03, 0.03, 0.05)))]
    for figures in patch_figures(scenes, grasps=12, gripper=load_gripper()):
        assert figures.grasps > 0
        assert figures.closure >= figures.closure_mean > 0
        assert figures.ratio_least >= 1 - 0.01  # the bounds of patches are 1 % apart
        assert figures.ratio_95_percent > 1.1
        assert -1 <= figures.rank_correlation <= 1


def test_bench_patches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (mesh,) = write_meshes(tmp_path, 1)
    assert main(["bench", "patches", str(mesh), "--grasps", "3", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["metric"] for row in rows] == ["real_d_quality", "real_s_quality"]
    assert main(["bench", "patches", str(mesh), "--grasps", "3"]) == 0
    assert "rank correlation" in capsys.readouterr().out
