"""The parts of a bias study on disk: taken up again, and run where they are missing."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gmdx.errors import Failure
from gmdx.files.folder import Kind, RunFolder
from gmdx.machine.executor import Crash
from gmdx.machine.packages import RESULTS, kernel_packages, versions
from gmdx.machine.progress import Follower, OnProgress
from gmdx.machine.tasks import run_tasks
from gmdx.metrics.compute import MetricConfig
from gmdx.studies.bias.replay import Replay, replay
from gmdx.trials.engines import ENGINES

BIAS_STUDY = Kind("bias study", "study.json")


def open_study(root: Path, settings: Mapping[str, Any], metric: MetricConfig) -> RunFolder:
    """A study's folder for this run, new or taken up again.

    Args:
        root: The folder.
        settings: What the parts depend on: names of the `engine` and the `reference` among it.
        metric: How metrics are computed.

    Raises:
        OutputError: The folder is in use, holds something else, or a study made otherwise.
        StorageError: The disk refused.
    """
    engines = [ENGINES[settings[name]].packages for name in ("engine", "reference")]
    kernels = kernel_packages(metric.quality.implementation)
    packages = versions((*RESULTS, *engines[0], *engines[1], *kernels))
    return RunFolder(root, BIAS_STUDY, {**settings, "packages": packages})


def run_missing(
    folder: RunFolder, tasks: Sequence[Replay], workers: int, on_progress: OnProgress | None
) -> tuple[Failure, ...]:
    """Run what is not there yet; a replay that fails costs nothing but itself.

    Raises:
        StorageError: The disk refused.
    """
    todo = [task for task in tasks if not (folder.root / task.part).is_file()]
    failures: list[Failure] = []
    follower = Follower(len(todo), on_progress)
    workers = min(workers, max(len(todo), 1))
    with contextlib.closing(run_tasks(replay, todo, workers=workers)) as finished:
        for item in finished:
            task, failure = item.task, item.result
            if isinstance(failure, Crash):
                failure = Failure(task.object_id, None, task.run.name, "Crash", str(failure))
            if failure is None:
                folder.publish(task.out, task.part)
            else:
                folder.discard(task.out)
                failures.append(failure)
            follower.finished(
                f"{task.object_id}, {task.run.label}",
                count=len(task.rows) if failure is None else 0,
                failures=() if failure is None else (failure,),
            )
    return tuple(sorted(failures, key=lambda failure: failure.key))
