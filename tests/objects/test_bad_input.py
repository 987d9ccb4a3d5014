"""Whatever a file holds, the outcome is an object or an error that says what is wrong."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gmdx.errors import MeshError
from gmdx.objects.prepare import load_object
from gmdx.objects.repair.read import as_trimesh
from gmdx.objects.repair.solid import misfit


def refused(path: Path, message: str) -> None:
    with pytest.raises(MeshError, match=message) as caught:
        load_object(path, cache=None)
    assert path.name in str(caught.value)


def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def small_box() -> trimesh.Trimesh:
    return trimesh.creation.box([0.03, 0.03, 0.06])


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "off", "glb", "gltf"])
def test_empty_files(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"nothing.{kind}"
    path.write_bytes(b"")
    refused(path, "empty")
    path.write_bytes(b" \n\n")
    refused(path, "empty")


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "off", "glb", "gltf"])
def test_binary_garbage(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"garbage.{kind}"
    path.write_bytes(np.random.default_rng(0).bytes(20_000))
    refused(path, "garbage")


@pytest.mark.parametrize("kind", ["obj", "stl", "stl_ascii", "ply", "off", "glb"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_truncated_files(tmp_path: Path, kind: str, share: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    if kind == "obj":  # as exporters write it: with whole lines of varied length
        data = write(tmp_path / "whole.obj", ball.vertices, ball.faces).read_bytes()
    else:
        exported = ball.export(file_type=kind)
        data = exported.encode() if isinstance(exported, str) else exported
    path = tmp_path / f"cut.{kind.split('_')[0]}"
    cut = int(share * len(data))
    while data[cut - 1 : cut] == b"\n":
        cut -= 1
    path.write_bytes(data[:cut])
    refused(path, "cut")


def test_a_cut_binary_stl_says_by_how_much(tmp_path: Path) -> None:
    path = tmp_path / "cut.stl"
    path.write_bytes(small_box().export(file_type="stl")[:300])
    refused(path, "300 bytes where a binary stl of 12 triangles, as its header says, has 684")


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "off", "glb"])
@pytest.mark.parametrize("named", ["obj", "stl", "ply", "off", "glb"])
def test_wrong_extensions(tmp_path: Path, kind: str, named: str) -> None:
    if kind == named:
        return
    exported = small_box().export(file_type=kind)
    path = tmp_path / f"wrong.{named}"
    path.write_bytes(exported.encode() if isinstance(exported, str) else exported)
    refused(path, "wrong")


def test_unknown_extensions(tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(b"\xff\xd8\xff")
    refused(path, "known: .*obj")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_vertices_that_are_no_numbers(tmp_path: Path, value: str) -> None:
    box = small_box()
    vertices = np.array(box.vertices)
    vertices[3, 1] = float(value)
    refused(write(tmp_path / "nan.obj", vertices, box.faces), "NaN or infinite")


def test_flat_meshes(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0), [0.0]), axis=-1).reshape(-1, 3)
    faces = np.array([[i, i + 1, i + 5] for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)])
    refused(write(tmp_path / "flat.obj", grid @ np.diag([1, 2, 1]), faces), "one plane")


def test_a_single_triangle(tmp_path: Path) -> None:
    refused(write(tmp_path / "one.obj", np.eye(3), np.array([[0, 1, 2]])), "1 triangles")


def test_vertices_without_faces(tmp_path: Path) -> None:
    refused(write(tmp_path / "cloud.obj", np.eye(3), np.zeros((0, 3), int)), "no triangle")


def test_all_vertices_alike(tmp_path: Path) -> None:
    box = small_box()
    refused(write(tmp_path / "point.obj", np.ones_like(box.vertices), box.faces), "too small")


def test_a_closed_surface_of_no_volume(tmp_path: Path) -> None:
    """Two sheets back to back, bent, so not in one plane: they cancel, and a shell is left."""
    x = np.linspace(0, 0.05, 6)
    vertices = np.array([[a, b, 4 * a * a] for a in x for b in (0.0, 0.03)])
    one = np.array([f for i in range(0, 10, 2) for f in ([i, i + 2, i + 1], [i + 1, i + 2, i + 3])])
    path = write(tmp_path / "sheet.obj", vertices, np.concatenate([one, one[:, ::-1]]))
    obj = load_object(path, cache=None)
    assert "make solid" in {step["step"] for step in obj.report["repair"]}
    assert 0 < obj.report["surface"]["volume"] < 0.05 * 0.03 * 0.002


@pytest.mark.parametrize("size", [1e-5, 1e-20])
def test_specks(tmp_path: Path, size: float) -> None:
    box = small_box()
    refused(write(tmp_path / "speck.obj", box.vertices * size, box.faces), "too small")


def test_far_from_the_origin(tmp_path: Path) -> None:
    box = small_box()
    refused(write(tmp_path / "far.obj", box.vertices + 1e9, box.faces), "too far|too small")


def test_faces_that_name_missing_vertices(tmp_path: Path) -> None:
    path = write(tmp_path / "broken.obj", small_box().vertices, np.array([[0, 1, 99]] * 5))
    refused(path, "broken")


def test_a_folder_in_place_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "folder.obj").mkdir()
    refused(tmp_path / "folder.obj", "cannot be read")


def test_self_intersecting_inside_out_parts_become_one_solid(tmp_path: Path) -> None:
    a, b = small_box(), small_box()
    b.apply_transform(trimesh.transformations.rotation_matrix(1.0, [1, 1, 0]))
    both = as_trimesh(
        np.concatenate([a.vertices, b.vertices]),
        np.concatenate([a.faces, np.asarray(b.faces)[:, ::-1] + 8]),
    )
    obj = load_object(write(tmp_path / "two.obj", both.vertices, both.faces), cache=None)
    assert misfit(obj.vertices, obj.faces) == 0
    union = trimesh.boolean.union([a, b], engine="manifold").volume
    assert obj.report["surface"]["volume"] == pytest.approx(union * obj.scale**3, rel=1e-6)


def test_a_million_triangles_in_a_broken_pipe(tmp_path: Path) -> None:
    """A header that promises more than there is does not exhaust memory."""
    path = tmp_path / "huge.stl"
    path.write_bytes(b"\0" * 80 + (2**32 - 1).to_bytes(4, "little") + b"\0" * 500)
    refused(path, "huge")


@pytest.mark.slow
def test_a_million_triangles(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=8, radius=0.02)
    ball.vertices *= [1.0, 1.2, 1.5]
    assert len(ball.faces) > 1_000_000
    ball.export(tmp_path / "dense.stl")
    obj = load_object(tmp_path / "dense.stl", cache=None)
    step = next(s for s in obj.report["repair"] if s["step"] == "simplify")
    assert len(obj.faces) <= 20_000
    assert step["deviation"] < 1e-4
    assert obj.report["surface"]["volume"] == pytest.approx(
        4 / 3 * np.pi * 0.02**3 * 1.8 * obj.scale**3, rel=1e-3
    )
    assert obj.report["seconds"]["read"] + obj.report["seconds"]["repair"] < 60
