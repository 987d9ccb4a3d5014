from pathlib import Path

import numpy as np
import pytest
import trimesh

from gmdx.errors import MeshError
from gmdx.objects.repair.read import is_closed, is_consistent, merge_vertices, patches, read_mesh


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "off", "glb"])
def test_every_format_gives_the_same_surface(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box([1.0, 2.0, 3.0])
    path = tmp_path / f"box.{kind}"
    box.export(path)
    mesh = read_mesh(path)
    assert len(mesh.faces) == 12
    assert mesh.volume == pytest.approx(6.0, rel=1e-6)


def test_parts_of_a_scene_are_put_in_their_places(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    ball = trimesh.creation.icosphere(subdivisions=1)
    for x in (0.0, 5.0):
        scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    scene.export(tmp_path / "two.glb")
    mesh = read_mesh(tmp_path / "two.glb")
    assert len(mesh.faces) == 2 * len(ball.faces)
    assert mesh.extents[0] == pytest.approx(5.0 + ball.extents[0], rel=1e-6)


def test_old_exporters_comments_are_no_obstacle(tmp_path: Path) -> None:
    text = trimesh.exchange.obj.export_obj(trimesh.creation.box([1.0, 1.0, 1.0]))
    path = tmp_path / "box.obj"
    path.write_bytes("# Würfel\n".encode("latin-1") + text.encode())
    assert len(read_mesh(path).faces) == 12


def test_vertices_split_along_seams_are_one() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    soup = ball.triangles.reshape(-1, 3).copy()
    soup += np.random.default_rng(0).uniform(-1e-8, 1e-8, soup.shape)
    faces = np.arange(len(soup)).reshape(-1, 3)
    vertices, merged = merge_vertices(soup, faces, tolerance=1e-6)
    assert len(vertices) == len(ball.vertices)
    assert is_closed(merged)
    assert is_consistent(merged)
    assert np.allclose(vertices[merged], ball.triangles, atol=1e-7)


def test_patches_end_where_three_faces_meet() -> None:
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    two = np.concatenate([box.faces, box.faces + 8])
    assert patches(two).max() == 1
    fin = np.concatenate([box.faces, [[*box.faces[0][:2], 8]]])
    label = patches(fin)
    assert len(set(label.tolist())) == 2
    assert (label == label[-1]).sum() == 1


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"nothing\.obj: no such file"):
        read_mesh(tmp_path / "nothing.obj")
