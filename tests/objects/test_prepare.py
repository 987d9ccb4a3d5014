import logging
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gmdx.errors import ConfigError, GmdxError, MeshError
from gmdx.geometry import quaternion_matrix
from gmdx.machine.caches import cache_folder
from gmdx.objects.model import ObjectModel
from gmdx.objects.prepare import PrepareConfig, load_object, prepare
from gmdx.objects.report import describe
from gmdx.objects.sources import resolve

SHARED = Path(__file__).parents[2].parent / "shared" / "objects"


def write(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


@pytest.fixture
def box_file(tmp_path: Path) -> Path:
    box = trimesh.creation.box([0.03, 0.04, 0.12])
    box.apply_translation([1.0, -2.0, 0.5])
    return write(box, tmp_path / "box.ply")


def assert_same(a: ObjectModel, b: ObjectModel) -> None:
    for name in ("vertices", "faces", "inertia"):
        assert np.array_equal(getattr(a, name), getattr(b, name))
    assert len(a.hulls) == len(b.hulls)
    assert all(np.array_equal(x, y) for x, y in zip(a.hulls, b.hulls, strict=True))
    for part in ("box", "stable_poses"):
        for f in fields(getattr(a, part)):
            assert np.array_equal(
                getattr(getattr(a, part), f.name), getattr(getattr(b, part), f.name)
            )
    assert (a.object_id, a.mass, a.friction, a.scale) == (b.object_id, b.mass, b.friction, b.scale)
    assert a.report == b.report


def test_a_cuboid_has_its_textbook_numbers(box_file: Path) -> None:
    obj = load_object(box_file, cache=None)
    assert obj.scale == 1.0  # no pose has both sides of its footprint above 5 cm
    assert obj.vertices.min(axis=0) == pytest.approx([-0.015, -0.02, -0.06], rel=1e-5)
    a, b, c = 0.03, 0.04, 0.12
    expected = 0.1 / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert obj.inertia == pytest.approx(expected, rel=1e-5, abs=1e-12)
    assert obj.box.extents == pytest.approx([c, b, a], rel=1e-5)
    assert obj.box.center == pytest.approx([0, 0, 0], abs=1e-8)
    assert len(obj.stable_poses.probabilities) == 6
    assert len(obj.hulls) == 1


def test_the_footprint_is_scaled_down_in_every_likely_pose(tmp_path: Path) -> None:
    path = write(trimesh.creation.box([0.06, 0.2, 0.3]), tmp_path / "big.stl")
    obj = load_object(path, cache=None)
    assert obj.scale == pytest.approx(0.05 / 0.2, rel=1e-5)  # lying flat: 0.2 x 0.3
    sides = []
    for q, p in zip(obj.stable_poses.quaternions, obj.stable_poses.probabilities, strict=True):
        size = np.ptp(obj.vertices @ quaternion_matrix(q).T, axis=0)
        assert p >= 0.01
        sides.append(size[:2].min())
    assert max(sides) == pytest.approx(0.05, rel=1e-5)
    heights = obj.stable_poses.heights
    assert sorted(set(np.round(heights, 6))) == pytest.approx([0.0075, 0.025, 0.0375], abs=1e-6)


def test_nothing_is_scaled_up(tmp_path: Path) -> None:
    path = write(trimesh.creation.box([0.01, 0.02, 0.01]), tmp_path / "small.stl")
    assert load_object(path, cache=None).scale == 1.0


def test_millimetres_are_scaled_and_noted(tmp_path: Path) -> None:
    path = write(trimesh.creation.box([30.0, 40.0, 120.0]), tmp_path / "mm.stl")
    obj = load_object(path, cache=None)
    assert any("millimetres" in w for w in obj.report["warnings"])
    assert obj.box.extents == pytest.approx([0.15, 0.05, 0.0375], rel=1e-5)
    told = load_object(path, scale=1e-3, cache=None)
    assert told.report["warnings"] == []
    assert told.scale == pytest.approx(1e-3)
    assert told.object_id != obj.object_id


def test_scaling_the_source_changes_only_the_scale(tmp_path: Path) -> None:
    mesh = trimesh.convex.convex_hull(
        np.random.default_rng(0).uniform(-1, 1, (14, 3)) * [0.05, 0.06, 0.2]
    )
    one = load_object(write(mesh, tmp_path / "a.ply"), cache=None)
    mesh.apply_scale(4.0)
    other = load_object(write(mesh, tmp_path / "b.ply"), cache=None)
    assert other.scale == pytest.approx(one.scale / 4, rel=1e-5)
    assert other.inertia == pytest.approx(one.inertia, rel=1e-4, abs=1e-12)


def test_the_cache_gives_back_the_same(box_file: Path, tmp_path: Path) -> None:
    kept = tmp_path / "cache"
    first = load_object(box_file, cache=kept)
    (file,) = kept.iterdir()
    stamp = file.stat().st_mtime_ns
    again = load_object(box_file, cache=kept)
    assert_same(first, again)
    assert_same(first, load_object(str(box_file), cache=str(kept)))
    assert file.stat().st_mtime_ns == stamp
    fresh = load_object(box_file, cache=None)
    assert_same(replace(fresh, report={}), replace(first, report={}))


def test_the_cache_knows_content_and_settings(box_file: Path, tmp_path: Path) -> None:
    kept = tmp_path / "cache"
    load_object(box_file, cache=kept)
    heavy = load_object(box_file, config=PrepareConfig(mass=0.2), cache=kept)
    assert heavy.mass == 0.2
    copy = box_file.with_name("renamed.ply")
    copy.write_bytes(box_file.read_bytes())
    renamed = load_object(copy, cache=kept)
    assert renamed.object_id.startswith("renamed-")
    assert renamed.report["source"]["file"] == "renamed.ply"
    assert len(list(kept.iterdir())) == 2
    write(trimesh.creation.box([0.01, 0.02, 0.03]), box_file)
    assert load_object(box_file, cache=kept).box.extents[0] == pytest.approx(0.03)


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_a_damaged_cache_file_is_made_anew(
    box_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    kept = tmp_path / "cache"
    first = load_object(box_file, cache=kept)
    (file,) = kept.iterdir()
    data = bytearray(file.read_bytes())
    if damage == "flip":
        data[200] ^= 0xFF
    file.write_bytes({"cut": data[:-300], "flip": data, "empty": b""}[damage])
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        again = load_object(box_file, cache=kept)
    assert "damaged" in caplog.text
    assert_same(replace(first, report={}), replace(again, report={}))
    assert_same(load_object(box_file, cache=kept), again)


def test_a_cache_that_cannot_be_written_is_no_obstacle(
    box_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        load_object(box_file, cache=tmp_path / "file" / "cache")
    assert "cannot keep" in caplog.text


def test_the_environment_says_where_the_cache_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, box_file: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("GMDX_CACHE", raising=False)
    assert cache_folder() == tmp_path / "xdg" / "gmdx"
    monkeypatch.setenv("GMDX_CACHE", str(tmp_path / "own"))
    load_object(box_file)
    assert len(list((tmp_path / "own").iterdir())) == 1


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="mass must be positive"):
        PrepareConfig(mass=0.0)
    with pytest.raises(ConfigError, match="max_footprint"):
        PrepareConfig(max_footprint=float("nan"))


def test_the_description_names_what_was_done(tmp_path: Path) -> None:
    box = trimesh.creation.box([30.0, 40.0, 120.0])
    box.invert()
    obj = load_object(write(box, tmp_path / "box.stl"), cache=None)
    text = describe(obj)
    for part in ("box.stl", "turn inside-out parts", "millimetres", "hulls", "merge vertices"):
        assert part in text


@pytest.mark.slow
def test_scans_keep_volume_centre_and_inertia(tmp_path: Path) -> None:
    """Against trimesh's own numbers for the source, wherever the source is closed."""
    if not SHARED.is_dir():
        pytest.skip("the scans are not here")
    names = ["kit/Shampoo_800_tex", "kit/Dwarf_800_tex", "kit/BlueSaltCube_800_tex",
             "ycb/YcbBanana", "ycb/YcbFoamBrick"]  # fmt: skip
    for name in names:
        path = SHARED / f"{name}.obj"
        obj = load_object(path, cache=tmp_path)
        source = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        source = trimesh.Trimesh(source.vertices, source.faces)  # merges by position
        assert source.is_watertight
        if source.volume < 0:
            source.invert()
        surface = trimesh.Trimesh(obj.vertices / obj.scale, obj.faces, process=False)
        assert surface.volume == pytest.approx(source.volume, rel=1e-3)
        assert np.abs(surface.center_mass).max() < 1e-6
        assert surface.bounds == pytest.approx(
            source.bounds - source.center_mass, abs=1e-3 * source.scale
        )
        inertia = source.moment_inertia * (obj.mass / source.volume * obj.scale**2)
        assert obj.inertia == pytest.approx(inertia, rel=1e-3, abs=1e-3 * np.abs(inertia).max())
        assert_same(load_object(path, cache=tmp_path), obj)


@pytest.mark.slow
def test_bundled_objects_need_no_repair(tmp_path: Path) -> None:
    for source in resolve(["bundled:egg", "bundled:plate", "bundled:cross"]):
        obj = prepare(source, cache=tmp_path)
        assert obj.object_id == source.name
        assert [s for s in obj.report["repair"] if s["step"] != "merge vertices"] == []
        assert obj.report["surface"]["volume_ratio"] == pytest.approx(1, rel=1e-9)


def test_a_truncated_scan_is_refused() -> None:
    path = SHARED / "kit" / "YellowSaltCylinder_800_tex.obj"
    if not path.is_file():
        pytest.skip("the scans are not here")
    with pytest.raises(MeshError, match="truncated"):
        load_object(path, cache=None)
    assert issubclass(MeshError, GmdxError)
