import importlib.util
from pathlib import Path

import pytest
import trimesh

import gmdx
from gmdx.errors import CatalogError, MeshError
from gmdx.objects.sources import resolve
from gmdx.objects.sources.bundled import bundled_names


def write_box(path: Path, size: float = 1.0, suffix: str = ".stl") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.with_suffix(suffix)
    trimesh.creation.box([size, size, size]).export(path)
    return path


def ids(*specs: str | Path) -> list[str]:
    return [source.object_id for source in resolve(specs)]


def test_bundled_objects_go_by_their_names() -> None:
    names = bundled_names()
    assert len(names) >= 16
    assert ids("bundled") == list(names)
    assert ids("bundled:mug") == ["mug"]
    assert all(source.path.is_file() for source in resolve(["bundled"]))


def test_folders_are_searched_through_and_other_files_left_out(tmp_path: Path) -> None:
    write_box(tmp_path / "a" / "deep" / "er")
    write_box(tmp_path / "b", suffix=".PLY")
    write_box(tmp_path / ".hidden" / "x")
    (tmp_path / "notes.txt").write_text("no mesh")
    assert [s.name for s in resolve([tmp_path])] == ["er", "b"]


def test_globs_match_files_and_folders(tmp_path: Path) -> None:
    for name in ("one", "two", "sub/three", "other/four"):
        write_box(tmp_path / name)
    assert {s.name for s in resolve([str(tmp_path / "**" / "t*.stl")])} == {"two", "three"}
    assert {s.name for s in resolve([str(tmp_path / "s?b")])} == {"three"}


def test_a_runs_own_output_is_not_found_among_its_objects(tmp_path: Path) -> None:
    write_box(tmp_path / "a")
    inside = write_box(tmp_path / "runs" / "out" / "objects" / "a" / "mesh")
    out = tmp_path / "runs" / "out"
    for spec in (tmp_path, tmp_path / "*", tmp_path / "**" / "*.stl"):
        assert [s.name for s in resolve([spec], leave_out=out)] == ["a"]
        assert len(resolve([spec])) == 2
    assert [s.name for s in resolve([inside], leave_out=out)] == ["mesh"]  # named: meant


def test_the_same_name_in_two_folders_gets_two_ids(tmp_path: Path) -> None:
    a, b = write_box(tmp_path / "a" / "part", 1.0), write_box(tmp_path / "b" / "part", 2.0)
    both = ids(tmp_path)
    assert len(set(both)) == 2
    assert all(i.startswith("part-") for i in both)
    assert ids(a) == both[:1]  # an id does not depend on what else is there
    assert ids(b) == both[1:]


def test_copies_of_one_file_all_get_in(tmp_path: Path) -> None:
    for name in ("a/part", "b/part", "c/Part", "c/other"):
        write_box(tmp_path / name)
    found = ids(tmp_path)
    assert len({i.lower() for i in found}) == 4
    assert [i.split("-", 1)[0] for i in found] == ["part", "part", "Part", "other"]


def test_an_id_survives_moving_the_file(tmp_path: Path) -> None:
    before = ids(write_box(tmp_path / "part"))
    (tmp_path / "part.stl").rename(tmp_path.parent / f"{tmp_path.name}-moved.stl")
    moved = (tmp_path.parent / f"{tmp_path.name}-moved.stl").rename(tmp_path / "part.stl")
    assert ids(moved) == before


def test_a_file_named_twice_is_taken_once(tmp_path: Path) -> None:
    path = write_box(tmp_path / "part")
    (tmp_path / "link.stl").symlink_to(path)
    assert len(resolve([path, str(path), tmp_path, str(tmp_path / "*.stl")])) == 1


def test_ids_are_safe_as_folder_names(tmp_path: Path) -> None:
    (object_id,) = ids(write_box(tmp_path / "..schräg & böse name"))
    assert object_id.replace("-", "").replace("_", "").replace(".", "").isalnum()
    assert object_id.isascii()
    assert not object_id.startswith((".", "-", "_"))


def test_a_named_file_is_taken_whatever_it_is(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8")
    assert len(resolve([tmp_path / "photo.jpg"])) == 1  # reading it says that it is no mesh


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nowhere", "no such file or folder"),
        ("bundled:teapot", "known: "),
        ("pybullet:cars", "random_urdfs"),
        ("pybullet:random_urdfs:many", "random_urdfs:N"),
        ("nowhere/*.obj", "no mesh file matches"),
    ],
)
def test_what_is_not_there_is_said(spec: str, message: str) -> None:
    with pytest.raises(CatalogError, match=message):
        resolve([spec])


@pytest.mark.parametrize("spec", ["", " "])
def test_an_empty_name_is_not_the_current_folder(spec: str) -> None:
    with pytest.raises(CatalogError, match="empty name"):
        resolve([spec])


def test_nothing_at_all_is_an_error() -> None:
    with pytest.raises(CatalogError, match="no objects given"):
        resolve([])


def test_a_folder_without_a_mesh_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no mesh")
    with pytest.raises(CatalogError, match="no mesh file in this folder"):
        resolve([tmp_path])


def test_without_pybullet_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)  # nothing is installed
    with pytest.raises(CatalogError, match=r"pip install 'gmdx\[bullet\]'"):
        resolve(["pybullet:random_urdfs:3"])


def test_pybullets_meshes_come_with_their_scale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if importlib.util.find_spec("pybullet_data") is None:  # a package laid out like it
        urdf = (
            '<robot name="b"><link name="l"><visual><geometry>'
            '<mesh filename="{0}.obj" scale="0.015 0.015 0.015"/>'
            "</geometry></visual></link></robot>"
        )
        for name in ("000", "001", "002"):
            folder = tmp_path / "pybullet_data" / "random_urdfs" / name
            write_box(folder / name, suffix=".obj")
            (folder / f"{name}.urdf").write_text(urdf.format(name))
        (tmp_path / "pybullet_data" / "__init__.py").write_text("raise ImportError('not needed')")
        monkeypatch.syspath_prepend(tmp_path)
    first, second = resolve(["pybullet:random_urdfs:2"])
    assert (first.object_id, second.object_id) == ("pybullet-000", "pybullet-001")
    assert 0 < first.scale < 0.1
    assert first.path.is_file()
    with pytest.raises(CatalogError, match="such objects"):
        resolve(["pybullet:random_urdfs:1001"])


def test_a_missing_file_is_told_by_reading_it_and_not_twice(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(MeshError, match=r"nothing\.obj"):
        gmdx.load_object(tmp_path / "nothing.obj", cache=None)
    assert not caplog.records
