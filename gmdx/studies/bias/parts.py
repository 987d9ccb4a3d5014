"""The parts of a bias study on disk: taken up again, and run where they are missing."""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gmdx.config import differences
from gmdx.dataset.schema import Failure
from gmdx.dataset.store import OutputError, writing
from gmdx.files.formats import json_text, read_json, write_text
from gmdx.machine.processes import Crash, run_tasks
from gmdx.studies.bias.replay import Replay, replay
from gmdx.trials.engines import ENGINES, choose

STUDY_FILE, PARTS_FOLDER = "study.json", "parts"
# Packages whose version can change a replay.
_PACKAGES = ("gmdx", "coacd", "mujoco", "numpy")


@dataclass(frozen=True)
class ReplayProgress:
    """Where a study stands, after each replay of an object."""

    object_id: str  # object and run finished last; "" at the start
    done: int  # replays finished now
    total: int  # replays to do now
    grasps: int  # replayed now
    failures: tuple[Failure, ...]  # of that replay


def begin(root: Path, header: Mapping[str, Any]) -> None:
    """Make a study's folder ready, or check that its parts are of this very study.

    Args:
        root: The folder.
        header: What the parts depend on; the packages' versions are added.

    Raises:
        OutputError: The folder holds something else, or a study made otherwise.
        StorageError: The disk refused.
    """
    engines = [choose(str(name)) for name in (header["engine"], header["reference"])]
    own = dict.fromkeys(package for engine in engines for package in ENGINES[engine].packages)
    packages = (*_PACKAGES, *own)
    versions = {"packages": {name: version(name) for name in packages}}
    text = json_text({**header, **versions})
    path = root / STUDY_FILE
    if path.is_file():
        changed = differences(read_json(path), json.loads(text))
        if changed:
            raise OutputError(
                f"{root} holds a study made otherwise ({changed[0][:120]}); give another folder, "
                "or the same options"
            )
        return
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise OutputError(f"{root} is not an empty folder nor a bias study; give a new one")
    with writing(root):
        root.mkdir(parents=True, exist_ok=True)
        put(path, text)


def run_missing(
    tasks: Sequence[Replay], workers: int, on_progress: Callable[[ReplayProgress], None] | None
) -> tuple[Failure, ...]:
    """Run what is not there yet; a replay that fails costs nothing but itself."""
    for partial in {path for task in tasks for path in task.out.parent.glob("*.partial")}:
        partial.unlink()  # what a killed run left
    todo = [task for task in tasks if not task.done]
    failures: list[Failure] = []
    grasps = 0

    def report(name: str, done: int, failed: tuple[Failure, ...]) -> None:
        if on_progress is not None:
            on_progress(ReplayProgress(name, done, len(todo), grasps, failed))

    report("", 0, ())
    workers = min(workers, max(len(todo), 1))
    with contextlib.closing(run_tasks(replay, todo, workers=workers)) as finished:
        for done, item in enumerate(finished, start=1):
            task, failure = item.task, item.result
            if isinstance(failure, Crash):
                failure = Failure(task.object_id, None, task.run.name, "Crash", str(failure))
            grasps += len(task.rows) if failure is None else 0
            failed = () if failure is None else (failure,)
            failures += failed
            report(f"{task.object_id}, {task.run.label}", done, failed)
    return tuple(sorted(failures, key=lambda failure: failure.key))


def put(path: Path, text: str) -> None:
    """A file at once."""
    partial = path.with_suffix(".partial")
    write_text(partial, text)
    partial.replace(path)
