"""The gripper's files in a dataset, so that it can be shown and replayed on any machine."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gmdx.dataset import schema
from gmdx.errors import DatasetError, GripperError
from gmdx.scenes.gripper import Gripper, gripper_record, load_gripper


def read_gripper(root: Path, record: Mapping[str, Any]) -> Gripper:
    """The gripper that a dataset was made with.

    Args:
        root: The dataset's folder.
        record: What `dataset.json` says about the gripper.

    Raises:
        DatasetError: Its files are missing, damaged or another gripper's.
    """
    path = root / schema.GRIPPER_FOLDER / schema.GRIPPER_FILE
    advice = f"remove {path.parent}, and the command that made the dataset writes it anew"
    if not path.is_file():
        raise DatasetError(
            f"{root} has no {path.relative_to(root)}; the dataset is damaged: {advice}"
        )
    try:
        gripper = load_gripper(path)
    except (GripperError, OSError) as error:
        raise DatasetError(f"the dataset is damaged: {error}; {advice}") from error
    found = gripper_record(gripper)
    if found != record:
        raise DatasetError(
            f"{path.parent} does not hold the gripper {record['name']!r} that the dataset was made "
            f"with (sha256 {found['sha256'][:12]}..., not {record['sha256'][:12]}...); {advice}"
        )
    return gripper
