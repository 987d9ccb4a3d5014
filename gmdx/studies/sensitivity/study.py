"""How much do labels depend on physical and numerical parameters of the trials?

The scenes and grasps are the same in all runs: settled and sampled once, at the defaults. A run
is the trials of one object's grasps with one choice of parameters. Pose noise has common random
numbers, so a difference between two runs is due to the parameters; the parameter `seed` redraws
it, and what `seed` does to an output is the noise floor of every other index.
"""

import contextlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gmdx.errors import GmdxError, SceneError, UsageError
from gmdx.files.formats import json_text, write_text
from gmdx.machine.executor import Crash
from gmdx.machine.packages import RESULTS, versions
from gmdx.machine.progress import Follower, OnProgress
from gmdx.machine.tasks import run_tasks
from gmdx.objects.prepare import CacheOption, content_hash
from gmdx.objects.sources import ObjectSource, resolve
from gmdx.pictures.figure import save_figure
from gmdx.scenes.gripper import DEFAULT_GRIPPER, Gripper, gripper_record, load_gripper
from gmdx.studies.sensitivity.figures import figures
from gmdx.studies.sensitivity.indices import METHODS, Design, Indices, make_design
from gmdx.studies.sensitivity.parameters import PARAMETERS, SEED, Parameter, Setup, parameters_named
from gmdx.studies.sensitivity.report import report
from gmdx.studies.sensitivity.result import ALL, SensitivityStudy, by_object, summary
from gmdx.studies.sensitivity.runs import (
    OUTPUTS,
    Chunk,
    Row,
    SetupTask,
    chunks,
    run_chunk,
    set_up,
)
from gmdx.studies.sensitivity.store import StudyFolder
from gmdx.trials.protocol import TRIALS

if TYPE_CHECKING:
    import pandas as pd

RESULT_FILE = "sensitivity.json"
REPORT_FILE = "report.html"
_FIGURES = "figures"
_CHUNK = 4  # runs handed to a worker at a time: what an interrupted study loses at most
_WIDE = 0.2  # half an interval of a share of variance beyond which a warning says so
_log = logging.getLogger("gmdx")


@dataclass(frozen=True)
class SensitivityConfig:
    """A sensitivity study."""

    parameters: tuple[str, ...] = tuple(PARAMETERS)  # `seed` comes along in any case
    method: str = "morris"  # morris, sobol or oat (one at a time)
    runs: int | None = None  # of each object at most; None: 10 trajectories, 64 rows or 7 places
    grasps: int = 16  # of each object
    trials: int = TRIALS  # of each grasp: the nominal one, and the rest with pose noise
    seed: int = 0  # of scenes, grasps, pose noise and design
    gripper: str = DEFAULT_GRIPPER  # a shipped gripper's name, or the path of a description
    workers: int = 1  # processes. Without effect on results
    cache: CacheOption = "user"  # folder of prepared objects; "user": the user's own

    def __post_init__(self) -> None:
        for name in ("grasps", "trials", "workers"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.method not in METHODS:
            raise UsageError(f"unknown method '{self.method}': give one of {', '.join(METHODS)}")
        parameters_named(self.parameters)


def sensitivity_study(
    objects: Sequence[str | Path] | str | Path,
    out: str | Path,
    config: SensitivityConfig | None = None,
    *,
    on_progress: OnProgress | None = None,
) -> SensitivityStudy:
    """Vary parameters of the trials, and find which ones the labels depend on.

    With the same arguments, a study is continued: what is in `out` is not run again. `out` then
    holds `runs.parquet`, `sensitivity.json`, `report.html` and `figures/`.

    Args:
        objects: `bundled`, files, folders, globs, or `pybullet:random_urdfs[:N]`.
        out: Folder of the study.
        config: What to vary, and how.
        on_progress: Called at the start and after every few runs.

    Raises:
        UsageError: An option is unknown or does not fit, the folder holds another study, or
            SALib is missing.
        SceneError: No object could be settled and grasped.
    """
    config = SensitivityConfig() if config is None else config
    parameters = parameters_named(config.parameters)
    names = tuple(parameter.name for parameter in parameters)
    design = make_design(
        config.method,
        names,
        runs=config.runs,
        seed=config.seed,
        levels=[len(parameter.levels) for parameter in parameters],
        shifted=(SEED,),
    )
    specs = [objects] if isinstance(objects, str | Path) else list(objects)
    sources = resolve([str(spec) for spec in specs], leave_out=Path(out))
    gripper = load_gripper(config.gripper)
    with StudyFolder(out, _settings(config, parameters, sources, gripper)) as folder:
        failures = _run_all(config, names, design, sources, gripper, folder, on_progress)
        rows = folder.rows(names)
        _check_complete(rows, sources, failures, design)
        runs = _frame(rows)
        found = {
            output.name: by_object(design, runs, output.name, config.seed) for output in OUTPUTS
        }
        _warn_of_wide_intervals(config.method, found)
        drawn = figures(config.method, parameters, {k: v[ALL] for k, v in found.items()}, runs)
        study = SensitivityStudy(
            folder.root, config.method, parameters, design, runs, found, drawn, failures
        )
        folder.finish(rows, names)
        _write(study, folder)
    return study


def _run_all(
    config: SensitivityConfig,
    names: tuple[str, ...],
    design: Design,
    sources: Sequence[ObjectSource],
    gripper: Gripper,
    folder: StudyFolder,
    on_progress: OnProgress | None,
) -> dict[str, str]:
    """Run what is not there yet; the objects that cannot be run, with the reason."""
    done: dict[str, set[int]] = {source.object_id: set() for source in sources}
    for row in folder.rows(names):
        done[str(row["object_id"])].add(int(row["run"]))
    each = len(design) + 1
    todo = [source for source in sources if len(done[source.object_id]) < each]
    total = sum(each - len(done[source.object_id]) for source in todo)
    per_run = config.grasps * config.trials
    _log.info(
        "%s: %d objects x %d runs (%d there already); %d grasps x %d trials each: %s trials to do",
        config.method, len(sources), each, len(sources) * each - total, config.grasps,
        config.trials, f"{total * per_run:,}",
    )  # fmt: skip
    setups, failures = _set_up_all(config, names, todo, gripper)
    total = sum(each - len(done[object_id]) for object_id in setups)
    tasks = [
        chunk
        for object_id, setup in setups.items()
        for chunk in chunks(object_id, setup, design, done=done[object_id], size=_CHUNK)
    ]
    follower = Follower(total, on_progress)
    workers = min(config.workers, max(len(tasks), 1))
    with contextlib.closing(run_tasks(run_chunk, tasks, workers=workers)) as results:
        for item in results:
            chunk: Chunk = item.task
            if isinstance(item.result, Crash):
                _log.warning("%s: runs %s: %s", chunk.object_id, chunk.runs, item.result)
                continue
            folder.add(item.result, names)
            trials = sum(int(row["trials"]) for row in item.result)
            follower.finished(chunk.object_id, things=len(item.result), count=trials)
    return failures


def _set_up_all(
    config: SensitivityConfig,
    names: tuple[str, ...],
    sources: Sequence[ObjectSource],
    gripper: Gripper,
) -> tuple[dict[str, Setup], dict[str, str]]:
    """Scenes and grasps of all objects, in their order, and why some have none."""
    tasks = [
        SetupTask(
            source, gripper, "hulls" in names, config.grasps, config.trials, config.seed,
            config.cache,
        )
        for source in sources
    ]  # fmt: skip
    setups: dict[str, Setup] = {}
    failures: dict[str, str] = {}
    workers = min(config.workers, max(len(tasks), 1))
    with contextlib.closing(run_tasks(set_up, tasks, workers=workers)) as results:
        for item in results:
            object_id = item.task.source.object_id
            if isinstance(item.result, Setup):
                setups[object_id] = item.result
            else:
                failures[object_id] = str(item.result)
                _log.warning("%s is left out: %s", object_id, item.result)
    order = [source.object_id for source in sources]
    return {key: setups[key] for key in order if key in setups}, failures


def _check_complete(
    rows: Sequence[Row],
    sources: Sequence[ObjectSource],
    failures: Mapping[str, str],
    design: Design,
) -> None:
    if len(failures) == len(sources):
        raise SceneError(f"no object can be studied: {'; '.join(failures.values())}")
    expected = (len(sources) - len(failures)) * (len(design) + 1)
    if len(rows) != expected:
        raise GmdxError(
            f"{expected - len(rows)} of {expected} runs were lost to crashed workers; the same "
            "command runs them again"
        )


def _warn_of_wide_intervals(method: str, found: Mapping[str, Mapping[str, Indices]]) -> None:
    """Say so where shares of variance are known too badly to be of use."""
    for output, by_name in found.items() if method == "sobol" else ():
        half = by_name[ALL].total_half
        if np.nan_to_num(half).max() > _WIDE:
            _log.warning(
                "%s: shares of variance are only known to within %.2g; more --runs are needed",
                output, np.nanmax(half),
            )  # fmt: skip


def _frame(rows: Sequence[Row]) -> "pd.DataFrame":
    import pandas as pd

    return pd.DataFrame(list(rows))


def _settings(
    config: SensitivityConfig,
    parameters: Sequence[Parameter],
    sources: Sequence[ObjectSource],
    gripper: Gripper,
) -> dict[str, Any]:
    """Everything that the runs depend on."""
    own = () if config.method == "oat" else ("SALib",)
    return {
        "method": config.method,
        "runs": config.runs,
        "grasps": config.grasps,
        "trials": config.trials,
        "seed": config.seed,
        "gripper": gripper_record(gripper),
        "parameters": {parameter.name: parameter.record() for parameter in parameters},
        "objects": {source.object_id: content_hash(source.path) for source in sources},
        "packages": versions((*RESULTS, *own)),
    }


def _write(study: SensitivityStudy, folder: StudyFolder) -> None:
    """The result, its pictures, and a report of both."""
    for name, figure in study.figures.items():
        with folder.replacing(f"{_FIGURES}/{name}.png") as path:
            save_figure(figure, path)
    result = summary(study)
    with folder.replacing(RESULT_FILE) as path:
        write_text(path, json_text(result))
    with folder.replacing(REPORT_FILE) as path:
        write_text(path, report(result, study.figures))
