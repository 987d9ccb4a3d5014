import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from gmdx.grasps.collide import collides
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.gripper import Gripper, load_gripper, shipped_grippers
from tests.support import box_object, mesh_object, resting_scene

EXTENTS = (0.04, 0.07, 0.09)


def _random_grasps(n: int) -> PlanarGrasp:
    rng = np.random.default_rng(5)
    center = np.column_stack([rng.uniform(-0.08, 0.08, (n, 2)), rng.uniform(-0.01, 0.15, n)])
    return PlanarGrasp(np.arange(n), center, rng.uniform(0, np.pi, n), rng.uniform(0.01, 0.08, n))


def _boxes(gripper: Gripper, width: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Centres and half extents of the gripper's geoms, in tool axes from the tool point."""
    model = mujoco.MjModel.from_xml_string(gripper.xml)
    data = mujoco.MjData(model)
    for name, position in zip(
        gripper.joints, gripper.finger_positions(np.array(width)), strict=True
    ):
        data.joint(name).qpos = position
    mujoco.mj_kinematics(model, data)
    return [
        (
            gripper.rotation @ (data.geom_xpos[i] - gripper.tool_point),
            np.abs(gripper.rotation @ data.geom_xmat[i].reshape(3, 3)) @ model.geom_size[i],
        )
        for i in range(model.ngeom)
    ]


def _gap(center: np.ndarray, half: np.ndarray, grasp_angle: float, place: np.ndarray) -> float:
    """Largest separation of a hand's box from the object's over the axes of a separating test.

    Both boxes are upright, so the faces' normals and the vertical decide.
    """
    cos, sin = np.cos(grasp_angle), np.sin(grasp_angle)
    hand = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = hand.T @ center + place - [0.0, 0.0, EXTENTS[2] / 2]
    axes = np.concatenate([hand, np.eye(3)])
    reach = np.abs(axes @ hand.T) @ half + np.abs(axes) @ (np.array(EXTENTS) / 2)
    return float((np.abs(axes @ middle) - reach).max())


@pytest.mark.parametrize("name", shipped_grippers())
def test_agrees_with_separating_axes_of_boxes(name: str) -> None:
    gripper = load_gripper(name)
    scene = resting_scene(box_object(EXTENTS))
    grasps = _random_grasps(300)
    found = collides(scene, grasps, gripper=gripper)
    expected = []
    for center, angle, width in zip(grasps.center, grasps.angle, grasps.width, strict=True):
        boxes = _boxes(gripper, width)
        gap = min(_gap(c, h, angle, center) for c, h in boxes)
        table = min(center[2] + c[2] - h[2] for c, h in boxes)
        expected.append(min(gap, table))
    clear = np.abs(expected) > 1e-5  # what just touches may go either way
    assert clear.sum() > 290
    np.testing.assert_array_equal(found[clear], np.array(expected)[clear] < 0)
    assert 0.2 < found.mean() < 0.9


def test_open_hand_above_the_object_is_free_and_one_in_it_is_not() -> None:
    gripper = load_gripper()
    scene = resting_scene(box_object(EXTENTS), yaw=0.5)
    grasps = PlanarGrasp(
        np.arange(4),
        np.array([[0.0, 0.0, 0.2], [0.0, 0.0, 0.05], [0.0, 0.0, 0.05], [0.2, 0.0, 0.005]]),
        np.full(4, 0.5),
        np.array([0.05, 0.05, 0.035, 0.05]),
    )
    # Above; astride; pads inside the box; beside it with the fingertips in the table.
    found = collides(scene, grasps, gripper=gripper)
    np.testing.assert_array_equal(found, [False, False, True, True])


def test_hulls_are_what_collides() -> None:
    # A U of three boxes: a finger fits between its walls, unless one hull covers it all.
    parts = [
        trimesh.creation.box(bounds=[low, high])
        for low, high in (
            ((-0.05, -0.02, 0.0), (0.05, 0.02, 0.01)),
            ((-0.05, -0.02, 0.01), (-0.04, 0.02, 0.06)),
            ((0.04, -0.02, 0.01), (0.05, 0.02, 0.06)),
        )
    ]
    mesh = trimesh.boolean.union(parts)
    hulls = [np.array(part.vertices) for part in parts]
    hollow = resting_scene(mesh_object(mesh, hulls=hulls))
    filled = resting_scene(mesh_object(mesh))
    center = np.array([[0.045, 0.0, 0.045]])  # on the right wall
    grasps = PlanarGrasp(np.zeros(1, int), center, np.zeros(1), np.array([0.03]))
    assert not collides(hollow, grasps, gripper=load_gripper())[0]
    assert collides(filled, grasps, gripper=load_gripper())[0]


def test_turning_the_world_changes_nothing() -> None:
    gripper = load_gripper()
    grasps = _random_grasps(200)
    before = collides(resting_scene(box_object(EXTENTS)), grasps, gripper=gripper)
    for turn, shift in itertools.product((0.7, 2.0), ([0.0, 0.0, 0.0], [0.4, -0.3, 0.0])):
        cos, sin = np.cos(turn), np.sin(turn)
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        scene = resting_scene(box_object(EXTENTS), yaw=turn)
        scene = replace(scene, position=scene.position + shift)
        turned = replace(
            grasps,
            center=grasps.center @ rotation.T + shift,
            angle=np.mod(grasps.angle + turn, np.pi),
        )
        np.testing.assert_array_equal(collides(scene, turned, gripper=gripper), before)
