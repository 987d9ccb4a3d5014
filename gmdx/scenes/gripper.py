"""Grippers as data: an MJCF model and a short description of how it grasps.

A description is a TOML file beside its MJCF file; the shipped ones are in `gmdx_assets`.
The gripper's own actuators are left out: gmdx drives the two finger joints by one
force-limited actuator, so that every gripper closes by the same rule.
"""

import hashlib
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any

import mujoco
import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import GripperError

DEFAULT_GRIPPER = "parallel_jaw"

_FIELDS = (
    "name", "model", "source", "joints", "pads", "stroke", "force", "tool_point",
    "closing_axis", "approach_axis",
)  # fmt: skip


@dataclass(frozen=True)
class Gripper:
    """A two-finger parallel gripper.

    Its tool frame has its origin midway between the centres of the pads' faces, x along the
    closing axis from pad 0 to pad 1, and z against the approach direction.
    """

    name: str
    description: str = field(repr=False)  # the TOML text
    xml: str = field(repr=False)  # MJCF with one root body
    files: Mapping[str, bytes] = field(repr=False)  # what the MJCF refers to, by file name
    joints: tuple[str, str]  # slide joints of finger 0 and 1
    pads: tuple[str, str]  # box geoms of finger 0 and 1
    stroke: float  # m, largest opening between the pads' faces
    force: float  # N, of each pad on the object
    tool_point: Float[Array, "3"]  # m, in the root body's frame
    rotation: Float[Array, "3 3"]  # from the root body's axes to the tool's
    signs: tuple[float, float]  # +1 where a positive joint position closes, else -1
    gap: float  # m, opening at joint positions 0
    pad_size: Float[Array, "2"]  # m, of a pad's face: along tool y, along tool z
    tip: float  # m, how far the lowest part reaches below the tool point

    def finger_positions(self, opening: Float[Array, "*n"]) -> Float[Array, "*n 2"]:
        """Joint positions at which the pads are `opening` m apart, each finger taking half."""
        travel = 0.5 * (self.gap - np.asarray(opening, float))
        return np.stack([sign * travel for sign in self.signs], axis=-1)

    def opening(self, positions: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
        """Opening between the pads at the given joint positions, m."""
        opening: Array = self.gap - np.sum(positions * np.array(self.signs), axis=-1)
        return opening


def shipped_grippers() -> tuple[str, ...]:
    """Names of the grippers that come with gmdx."""
    folder = files("gmdx_assets") / "grippers"
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    )


def load_gripper(name_or_file: str | Path = DEFAULT_GRIPPER) -> Gripper:
    """A shipped gripper by name, or a user's own by the path of its description.

    Args:
        name_or_file: One of `shipped_grippers()`, or a TOML file like the shipped ones.

    Raises:
        GripperError: The name is unknown, or the description and its model do not fit.
    """
    text = str(name_or_file)
    shipped = text in shipped_grippers()
    path = Path(str(files("gmdx_assets") / "grippers" / f"{text}.toml")) if shipped else Path(text)
    if not path.is_file():
        raise GripperError(
            f"no gripper '{text}': give one of {', '.join(shipped_grippers())}, "
            "or the path of a description (a TOML file)"
        )
    try:
        description = path.read_text(encoding="utf-8")
        named = tomllib.loads(description).get("model", "")
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise GripperError(f"{path} is not a TOML file: {error}") from error
    model = path.parent / str(named)
    if not _inside(str(named)) or not model.is_file():
        raise GripperError(f"{path}: the field 'model' must name an MJCF file beside it")
    xml = model.read_text(encoding="utf-8")
    return _gripper(description, xml, _files_of(xml, model.parent, where=text), where=text)


def save_gripper(gripper: Gripper, description: Path) -> None:
    """Write a gripper's files, so that `load_gripper(description)` gives the same one anywhere.

    Args:
        gripper: As it was loaded.
        description: The TOML file to write; its MJCF model and that model's files come beside it.

    Raises:
        GripperError: It was changed since it was loaded, so that its description is another's.
    """
    model = description.parent / str(tomllib.loads(gripper.description)["model"])
    places = _places(gripper.xml)
    contents = {
        description: gripper.description.encode(),
        model: gripper.xml.encode(),
        **{
            model.parent / (place if _inside(str(place := places[name])) else name): content
            for name, content in gripper.files.items()
        },
    }
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    if gripper_record(load_gripper(description)) != gripper_record(gripper):
        raise GripperError(
            f"the gripper {gripper.name!r} was changed after it was loaded, so its description "
            "does not say what it is: write a description of the changed one and load that"
        )


def _inside(path: str) -> bool:
    """Whether a path stays in the folder that it starts from, and names something in it."""
    pure = PurePosixPath(path)
    return bool(pure.parts) and not pure.is_absolute() and ".." not in pure.parts


def _places(xml: str) -> dict[str, PurePosixPath]:
    """Where the files that an MJCF model refers to lie, from the model's folder, by file name."""
    root = ET.fromstring(xml)
    folders = {
        kind: compiler.get(f"{kind}dir", compiler.get("assetdir"))
        for compiler in root.iter("compiler")
        for kind in ("mesh", "texture")
    }
    places: dict[str, PurePosixPath] = {}
    for element in root.iter():
        if (file := element.get("file")) is not None:
            folder = folders.get("texture" if element.tag == "texture" else "mesh")
            place = PurePosixPath(folder if folder is not None else "", file)
            if places.setdefault(place.name, place) != place:
                raise GripperError(
                    f"the model refers to {places[place.name]} and to {place}: MuJoCo tells them "
                    "apart by their file names alone, so rename one"
                )
    return places


def _files_of(xml: str, folder: Path, *, where: str) -> dict[str, bytes]:
    """What a model refers to, by file name: from where it says, or from anywhere beneath.

    A file that is not there is left to MuJoCo to name.
    """
    try:
        places = _places(xml)
    except ET.ParseError as error:
        raise GripperError(f"gripper {where}: MuJoCo cannot read its model: {error}") from error
    except GripperError as error:
        raise GripperError(f"gripper {where}: {error}") from error
    contents: dict[str, bytes] = {}
    for name, place in sorted(places.items()):
        said = folder / place
        found = [said] if said.is_file() else sorted(folder.rglob(name))
        if len(found) > 1:
            raise GripperError(
                f"gripper {where}: the model's file {place} may be any of "
                f"{', '.join(str(path.relative_to(folder)) for path in found)}: say which"
            )
        if found:
            contents[name] = found[0].read_bytes()
    return contents


def _gripper(text: str, xml: str, beside: Mapping[str, bytes], *, where: str) -> Gripper:
    """Check a description against its compiled model, and derive what follows from both."""
    description = tomllib.loads(text)

    def fail(what: str) -> GripperError:
        return GripperError(f"gripper {where}: {what}")

    unknown = sorted(set(description) - set(_FIELDS))
    missing = sorted(set(_FIELDS) - {"source"} - set(description))
    if unknown or missing:
        raise fail(f"unknown fields {unknown}, missing fields {missing}; known: {list(_FIELDS)}")
    try:
        model = mujoco.MjModel.from_xml_string(xml, dict(beside))
    except ValueError as error:
        raise fail(f"MuJoCo cannot read {description['model']}: {error}") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)

    rotation = _tool_rotation(description, fail)
    root = _only_root(model, fail)
    to_root = data.xmat[root].reshape(3, 3).T
    tool_point = np.array(description["tool_point"], float)

    signs, faces, sizes = [], [], []
    for side, (joint_name, pad_name) in enumerate(
        zip(description["joints"], description["pads"], strict=True)
    ):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint_name)
        pad = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, pad_name)
        if joint < 0 or pad < 0:
            raise fail(f"the model has no joint '{joint_name}' or no geom '{pad_name}'")
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
            raise fail(f"joint '{joint_name}' is not a slide joint; linkages are not supported")
        if model.geom_type[pad] != mujoco.mjtGeom.mjGEOM_BOX:
            raise fail(f"pad '{pad_name}' is not a box; mesh pads give bad contact forces")
        inward = 1.0 if side == 0 else -1.0  # tool x direction in which this finger closes
        axis = rotation @ to_root @ data.xaxis[joint]
        if abs(abs(axis[0]) - 1) > 1e-6:
            raise fail(f"joint '{joint_name}' does not slide along the closing axis")
        signs.append(float(np.sign(axis[0]) * inward))
        orientation = rotation @ to_root @ data.geom_xmat[pad].reshape(3, 3)
        half = np.abs(orientation) @ model.geom_size[pad]
        if np.abs(np.sort(np.abs(orientation), axis=1)[:, -1] - 1).max() > 1e-6:
            raise fail(f"pad '{pad_name}' is not aligned with the closing and approach axes")
        center = rotation @ (to_root @ (data.geom_xpos[pad] - data.xpos[root]) - tool_point)
        faces.append(center + np.array([inward * half[0], 0.0, 0.0]))
        sizes.append(2 * half[1:])
    middle = 0.5 * (faces[0] + faces[1])
    if np.abs(middle).max() > 1e-6 or np.abs((faces[1] - faces[0])[1:]).max() > 1e-6:
        raise fail(
            f"tool_point is {np.round(1e3 * middle, 3)} mm (tool axes) from the middle of the "
            "pads' faces at joint positions 0"
        )
    gap = float(faces[1][0] - faces[0][0])
    stroke, force = float(description["stroke"]), float(description["force"])
    if not (0 < stroke <= gap + 1e-9 and force > 0):
        raise fail(
            f"stroke {stroke} m must be positive and at most the {gap:.4f} m between the pads at "
            f"joint positions 0, and force {force} N positive"
        )
    return Gripper(
        name=str(description["name"]),
        description=text,
        xml=xml,
        files=beside,
        joints=(description["joints"][0], description["joints"][1]),
        pads=(description["pads"][0], description["pads"][1]),
        stroke=stroke,
        force=force,
        tool_point=tool_point,
        rotation=rotation,
        signs=(signs[0], signs[1]),
        gap=gap,
        pad_size=np.minimum(sizes[0], sizes[1]),
        tip=max(
            -float((rotation @ (to_root @ (corner - data.xpos[root]) - tool_point))[2])
            for corner in _corners(model, data)
        ),
    )


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> Float[Array, "c 3"]:
    """Corners of the boxes around all geoms, in the model's world, m."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    return np.concatenate(
        [
            data.geom_xpos[g]
            + (model.geom_aabb[g, :3] + signs * model.geom_aabb[g, 3:])
            @ data.geom_xmat[g].reshape(3, 3).T
            for g in range(model.ngeom)
        ]
    )


def _tool_rotation(description: dict[str, Any], fail: Any) -> Float[Array, "3 3"]:
    x = np.array(description["closing_axis"], float)
    z = -np.array(description["approach_axis"], float)
    if x.shape != (3,) or z.shape != (3,) or not np.allclose([x @ x, z @ z, x @ z], [1, 1, 0]):
        raise fail("closing_axis and approach_axis must be perpendicular unit vectors")
    if len(description["joints"]) != 2 or len(description["pads"]) != 2:
        raise fail("joints and pads must name two each")
    return np.stack([x, np.cross(z, x), z])


def _only_root(model: mujoco.MjModel, fail: Any) -> int:
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    if len(roots) != 1 or model.njnt != 2:
        raise fail(
            f"the model must have one root body and two joints, it has {len(roots)} and "
            f"{model.njnt}"
        )
    return roots[0]


def gripper_record(gripper: Gripper) -> dict[str, Any]:
    """A gripper as `dataset.json` names it: lengths in m, the force in N."""
    return {
        "name": gripper.name,
        "sha256": _gripper_hash(gripper),
        "stroke": gripper.stroke,
        "force": gripper.force,
        "pad_size": [float(size) for size in gripper.pad_size],
    }


def _gripper_hash(gripper: Gripper) -> str:
    """SHA-256 of everything that a gripper's description and model say, however it is worded."""
    digest = hashlib.sha256()
    for name, value in sorted(vars(gripper).items()):
        if name == "description":
            continue
        text = np.asarray(value).tolist() if isinstance(value, np.ndarray) else value
        digest.update(f"{name}={text!r};".encode())
    return digest.hexdigest()
