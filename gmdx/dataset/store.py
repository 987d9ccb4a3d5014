"""A dataset's folder while it is produced: objects come into place whole, failures are kept."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gmdx.dataset import schema
from gmdx.errors import DatasetError, Failure
from gmdx.files.folder import Kind, OutputError, RunFolder, writing
from gmdx.files.formats import read_json, write_text
from gmdx.scenes.gripper import Gripper, save_gripper

DATASET = Kind("dataset", schema.DATASET_FILE, folders=(schema.OBJECTS_FOLDER,))


class DatasetStore:
    """A dataset during one run; a context manager that holds its folder.

    An object is written into a folder of its attempt and renamed into place, so that `objects/`
    only ever holds complete ones.
    """

    def __init__(self, root: str | Path, header: Mapping[str, Any]) -> None:
        """Make `root` ready for a run, or take it up again.

        Args:
            root: The folder; created if it does not exist.
            header: What `dataset.json` says about the run: everything that results depend on.

        Raises:
            OutputError: The folder is not empty and not a dataset, cannot be written, is being
                written by another run, or holds a dataset made with another header.
            StorageError: The disk refused.
        """
        self.root = Path(root)
        self.objects = self.root / schema.OBJECTS_FOLDER
        self._folder = RunFolder(
            root,
            DATASET,
            {"schema_version": schema.SCHEMA_VERSION, **header},
            state={"status": "running", "counts": None},
        )
        try:
            with writing(self.root):
                self.objects.mkdir(exist_ok=True)
            self._forget_cut_line()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "DatasetStore":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove what is not complete and let other runs in."""
        self._folder.close()

    def complete(self) -> set[str]:
        """Ids of the objects that are in place.

        Raises:
            OutputError: One has lost a file, which no run does: objects come into place whole.
        """
        found = [folder for folder in self.objects.iterdir() if folder.is_dir()]
        for folder in sorted(found):
            lost = [name for name in schema.RESULT_FILES if not (folder / name).is_file()]
            if lost:
                raise OutputError(
                    f"{folder} has no {', '.join(lost)}: the dataset is damaged; remove that "
                    "folder, and the same command makes the object anew"
                )
        return {folder.name for folder in found}

    def put_gripper(self, gripper: Gripper) -> None:
        """Put the gripper's files into place, unless they are there already.

        Raises:
            StorageError: The disk refused.
            GripperError: The gripper was changed after it was loaded.
        """
        if not (self.root / schema.GRIPPER_FOLDER).is_dir():
            attempt = self._folder.attempt(schema.GRIPPER_FOLDER)
            with writing(self.root):
                save_gripper(gripper, attempt / schema.GRIPPER_FILE)
            self._folder.publish(attempt, schema.GRIPPER_FOLDER)

    def attempt(self, object_id: str) -> Path:
        """A new folder to write an object into, once; nothing is there yet."""
        return self._folder.attempt(object_id)

    def publish(self, attempt: Path, object_id: str) -> None:
        """Put a written object into place.

        Raises:
            StorageError: The disk refused.
        """
        self._folder.publish(attempt, f"{schema.OBJECTS_FOLDER}/{object_id}")

    def discard(self, attempt: Path) -> None:
        """Remove what there is of an attempt that failed."""
        self._folder.discard(attempt)

    def record(self, failures: Iterable[Failure]) -> None:
        """Append failures while the run goes on.

        Raises:
            StorageError: The disk refused.
        """
        path = self.root / schema.FAILURES_FILE
        with writing(path), path.open("a", encoding="utf-8", newline="\n") as file:
            file.writelines(_line(failure) for failure in failures)

    def finish(self, failures: Iterable[Failure], *, sources: set[str]) -> dict[str, int]:
        """Write the final failures and counts.

        Args:
            failures: Of the objects that this run did not produce.
            sources: Ids of every object that this run was asked for.

        Returns:
            The counts in `dataset.json`: objects, scenes, grasps, failures.

        Raises:
            StorageError: The disk refused.
        """
        everything = {failure.key: failure for failure in failures}
        counts = {"objects": 0, "scenes": 0, "grasps": 0}
        complete = self.complete()
        for object_id in sorted(complete):
            described = read_json(self.objects / object_id / schema.OBJECT_FILE)
            counts["objects"] += 1
            counts["scenes"] += len(described["scenes"])
            counts["grasps"] += sum(scene["grasps"] for scene in described["scenes"])
            for values in described["failures"]:
                failure = Failure(**values)
                everything[failure.key] = failure
        for failure in read_failures(self.root):  # of objects that an earlier run was asked for
            if failure.object_id not in sources | complete:
                everything[failure.key] = failure
        counts["failures"] = len(everything)
        ordered = [everything[key] for key in sorted(everything)]
        self._replace_failures("".join(map(_line, ordered)))
        self._folder.write_header({"status": "complete", "counts": counts})
        return counts

    def _forget_cut_line(self) -> None:
        """Remove the last line of the failures where a run was killed while it appended it."""
        path = self.root / schema.FAILURES_FILE
        whole, _, cut = (path.read_text("utf-8") if path.is_file() else "").rpartition("\n")
        if cut:
            self._replace_failures(f"{whole}\n" if whole else "")

    def _replace_failures(self, text: str) -> None:
        with self._folder.replacing(schema.FAILURES_FILE) as path:
            write_text(path, text)


def read_failures(root: Path) -> list[Failure]:
    """The failures of a dataset, in order; none where the file does not exist yet.

    Raises:
        DatasetError: The file is damaged.
    """
    path = root / schema.FAILURES_FILE
    if not path.is_file():
        return []
    failures = []
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            failures.append(Failure(**json.loads(line)))
        except (ValueError, TypeError) as error:
            if number == len(lines):  # cut off when a run was killed while it appended
                break
            raise DatasetError(f"{path}, line {number} is damaged: {error}") from error
    return failures


def _line(failure: Failure) -> str:
    return json.dumps(asdict(failure), sort_keys=True) + "\n"
