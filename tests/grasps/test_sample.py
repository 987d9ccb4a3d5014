import itertools
import logging
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gmdx.errors import ConfigError, GraspError, UsageError
from gmdx.grasps.candidates import dense
from gmdx.grasps.collide import collides
from gmdx.grasps.contact import closing_contacts
from gmdx.grasps.sample import SAMPLERS, SampleConfig, sample_grasps
from gmdx.objects.surface import random_points, surface_of
from gmdx.scenes.gripper import load_gripper, shipped_grippers
from gmdx.scenes.scene import Scene
from tests.support import box_object, cylinder_object, mesh_object, resting_scene, sphere_object

GRIPPER = load_gripper()


def _tube(r_min: float, r_max: float, height: float) -> Scene:
    """A tube whose hulls leave it open."""
    mesh = trimesh.creation.annulus(r_min=r_min, r_max=r_max, height=height, sections=32)
    edges = np.linspace(0, 2 * np.pi, 33)
    hulls = [
        np.array(
            [
                [r * np.cos(a), r * np.sin(a), z]
                for a in (start, end)
                for r in (r_min, r_max)
                for z in (-height / 2, height / 2)
            ]
        )
        for start, end in itertools.pairwise(edges)
    ]
    return resting_scene(mesh_object(mesh, hulls=hulls, object_id="tube"))


SCENES = {
    "box": resting_scene(box_object((0.04, 0.06, 0.08)), yaw=0.3),
    "ball": resting_scene(sphere_object(0.03)),
    "bar": resting_scene(box_object((0.03, 0.2, 0.02))),
    "tall": resting_scene(cylinder_object(0.02, 0.2)),
    "tube": _tube(0.028, 0.032, 0.06),
}


@pytest.mark.parametrize("gripper_name", shipped_grippers())
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("name", sorted(SCENES))
def test_every_grasp_is_possible(name: str, sampler: str, gripper_name: str) -> None:
    scene, gripper = SCENES[name], load_gripper(gripper_name)
    grasps = sample_grasps(scene, 24, sampler=sampler, gripper=gripper)
    assert len(grasps) == 24
    assert len(np.unique(grasps.grasp_id)) == 24
    assert (grasps.width > 0).all()
    assert (grasps.width <= gripper.stroke + 1e-12).all()
    assert ((grasps.angle >= 0) & (grasps.angle < np.pi)).all()
    top = scene.to_world(scene.object.vertices)[:, 2].max()
    assert (grasps.center[:, 2] >= 0.5 * gripper.pad_size[1]).all()  # pads above the table
    assert (grasps.center[:, 2] <= max(top, 0.03) + 1e-9).all()
    assert closing_contacts(scene, grasps, gripper=gripper).pads.both.all()
    assert collides(scene, grasps, gripper=gripper).mean() <= SampleConfig().colliding_share


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_first_grasps_do_not_depend_on_how_many_are_asked_for(sampler: str) -> None:
    scene = SCENES["box"]
    many = sample_grasps(scene, 150, sampler=sampler)
    few = sample_grasps(scene, 20, sampler=sampler)
    for name in ("grasp_id", "center", "angle", "width"):
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name)[:20])


def test_key_decides_the_grasps() -> None:
    scene = SCENES["box"]
    first = sample_grasps(scene, 10)
    np.testing.assert_array_equal(first.center, sample_grasps(scene, 10).center)
    renamed = replace(scene, object=replace(scene.object, object_id="other"))
    for other in (replace(scene, seed=1), replace(scene, scene_id=1), renamed):
        assert not np.allclose(first.center, sample_grasps(other, 10).center)


def test_opening_straddles_a_box_with_clearance() -> None:
    scene = resting_scene(box_object((0.03, 0.2, 0.04)))
    grasps = sample_grasps(scene, 60, config=SampleConfig(surface_points=20000))
    along = np.abs(np.cos(grasps.angle)) > np.cos(0.05)  # closing across the bar
    assert along.sum() > 1
    for grasp in np.flatnonzero(along):
        off, turn = np.abs(grasps.center[grasp, 0]), grasps.angle[grasp]
        room = grasps.width[grasp] / 2 - (0.015 + off)
        # The finger's half width of 10 mm and margin widen what it sweeps at an angle.
        slack = 0.012 * np.abs(np.tan(turn)) + 0.03 * (1 / np.abs(np.cos(turn)) - 1)
        assert 0.005 - 0.002 <= room <= 0.010 + slack


def test_dense_candidates_cover_the_silhouette_the_heights_and_the_angles() -> None:
    scene = resting_scene(box_object((0.04, 0.08, 0.1)), yaw=0.8)
    surface = surface_of(scene.to_world(scene.object.vertices), scene.object.faces)
    blocks = list(dense(surface, 2000, 0.02, np.random.default_rng(0)))
    center = np.concatenate([block.center for block in blocks])
    angle = np.concatenate([block.angle for block in blocks])
    assert len(center) == 2000  # the rectangle along the footprint's axes is the footprint
    local = scene.to_object(center)
    fractions = np.column_stack(
        [local[:, 0] / 0.04, local[:, 1] / 0.08, (center[:, 2] - 0.06) / 0.08, angle / np.pi - 0.5]
    )
    assert (np.abs(fractions) <= 0.5 + 1e-12).all()
    for column in fractions.T:  # far more even than chance (0.03 here)
        sorted_ = np.sort(column) + 0.5
        assert np.abs(sorted_ - (np.arange(2000) + 0.5) / 2000).max() < 0.01
    assert np.abs(np.corrcoef(fractions.T) - np.eye(4)).max() < 0.03
    # Each of 2^4 boxes gets its share.
    corner = (fractions > 0) @ [1, 2, 4, 8]
    assert np.abs(np.bincount(corner, minlength=16) - 125).max() < 12


def test_dense_positions_lie_above_a_ring_not_in_its_hole() -> None:
    surface = surface_of(
        SCENES["tube"].to_world(SCENES["tube"].object.vertices), SCENES["tube"].object.faces
    )
    blocks = dense(surface, 1000, 0.02, np.random.default_rng(1))
    center = np.concatenate([block.center for block in blocks])
    radius = np.hypot(center[:, 0], center[:, 1])
    assert radius.min() > 0.0278
    assert radius.max() < 0.0321
    # The ring's share of the square around it.
    assert len(center) == pytest.approx(1000 * np.pi * (0.032**2 - 0.028**2) / 0.064**2, rel=0.15)


def test_antipodal_points_lie_in_each_others_friction_cones() -> None:
    scene = SCENES["ball"]
    grasps = sample_grasps(scene, 40, sampler="antipodal")
    grasps = grasps[grasps.center[:, 2] > 0.0131]  # not raised off the pair by the table
    contacts = closing_contacts(scene, grasps, gripper=GRIPPER).center
    assert contacts.both.all()
    cone = np.arctan(scene.object.friction)
    for pad, sign in ((0, 1.0), (1, -1.0)):
        cosine = (contacts.normals[:, pad, 0] * sign * (grasps.axis @ scene.rotation)).sum(axis=1)
        assert np.arccos(np.clip(cosine, -1, 1)).max() <= cone + 1e-6
    middle = contacts.points[:, :, 0].mean(axis=1)
    np.testing.assert_allclose(middle, scene.to_object(grasps.center), atol=1e-6)


def test_antipodal_finds_the_wall_of_a_tube_and_the_whole_of_it() -> None:
    grasps = sample_grasps(SCENES["tube"], 60, sampler="antipodal")
    off_axis = np.hypot(grasps.center[:, 0], grasps.center[:, 1])
    assert (off_axis > 0.02).any()  # one finger inside
    assert (off_axis < 0.005).any()  # both outside
    assert grasps.width[off_axis > 0.02].min() < 0.03


def test_random_points_are_uniform_over_the_surface() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    surface = surface_of(np.array(mesh.vertices), np.array(mesh.faces))
    drawn = random_points(surface, 20000, np.random.default_rng(0))
    points, face = drawn.points, drawn.face
    # Archimedes: heights on a sphere are uniform.
    heights = np.sort(points[:, 2]) / 0.06 + 0.5
    assert np.abs(heights - np.linspace(0, 1, 20000)).max() < 0.02
    off = ((points - surface.vertices[surface.faces[face, 0]]) * surface.normals[face]).sum(axis=1)
    assert np.abs(off).max() < 1e-15


def test_impossible_wishes_are_named() -> None:
    with pytest.raises(UsageError, match="dense, antipodal"):
        sample_grasps(SCENES["box"], 3, sampler="random")
    with pytest.raises(UsageError, match="1 or more"):
        sample_grasps(SCENES["box"], 0)
    wide = resting_scene(cylinder_object(0.13, 0.1))
    with pytest.raises(GraspError, match=r"'cylinder', scene 0.*stroke 85 mm"):
        sample_grasps(wide, 3, config=SampleConfig(candidates=512))
    flat = resting_scene(box_object((0.05, 0.1, 0.0005)))
    with pytest.raises(GraspError, match="too flat"):
        sample_grasps(flat, 3, config=SampleConfig(candidates=512))


@pytest.mark.parametrize(
    "values",
    [
        {"candidates": 0},
        {"clearance": (0.01, 0.005)},
        {"least_clearance": 0.02},
        {"table_clearance": 0.001},
        {"colliding_share": 1.5},
    ],
)
def test_configurations_that_make_no_sense_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(values))):
        SampleConfig(**values)


def test_fewer_grasps_than_asked_for_are_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        grasps = sample_grasps(SCENES["ball"], 500, config=SampleConfig(candidates=200))
    assert 0 < len(grasps) < 200
    assert f"only {len(grasps)} grasps found, 500 asked for" in caplog.text
