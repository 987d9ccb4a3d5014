"""How much labels depend on the engine: a dataset's grasps again in another one, and a noise floor.

```
<out>/
  study.json        what the parts depend on: dataset, options, gripper
  parts/<object_id>/<run>.parquet   one run of one object's grasps; each comes into place whole
  pairs.parquet     a row per grasp: every run's outcomes and metrics side by side
  bias.json         all statistics
  report.html       the same to read, in one file
```
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gmdx.config import merge
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.dataset.schema import DATASET_FILE
from gmdx.errors import UsageError
from gmdx.files.folder import RunFolder
from gmdx.files.formats import json_text, write_text
from gmdx.machine.progress import OnProgress
from gmdx.metrics.compute import MetricConfig
from gmdx.objects.prepare import content_hash
from gmdx.rng import generator
from gmdx.scenes.gripper import Gripper
from gmdx.studies.bias.compare import Comparison, compare, most_disputed
from gmdx.studies.bias.pairs import write_pairs
from gmdx.studies.bias.parts import open_study, run_missing
from gmdx.studies.bias.replay import Replay, Run, RunRows, read_parts, runs_of
from gmdx.studies.bias.result import BiasConfig, BiasStudy, Choice
from gmdx.studies.engines import TruthRow, truth_table
from gmdx.trials.engines import choose as choose_engine
from gmdx.trials.engines import open_engine
from gmdx.trials.protocol import TrialConfig

PAIRS_FILE, STATISTICS_FILE, REPORT_FILE = "pairs.parquet", "bias.json", "report.html"


def bias_study(
    dataset: Dataset | str | Path,
    out: str | Path,
    config: BiasConfig | None = None,
    *,
    on_progress: OnProgress | None = None,
) -> BiasStudy:
    """Replay a dataset's grasps in a second engine; with the same arguments, continue.

    Args:
        dataset: What to replay, with its own configuration, scenes, grasps and pose noise.
        out: Folder of the study.
        config: What to do; see `BiasConfig`.
        on_progress: Called at the start and after each replay of an object.

    Raises:
        UsageError: The second engine is not known or not installed, or the options or the folder
            do not fit the dataset.
        DatasetError: The dataset or a part is damaged, or the disk refused a write.
    """
    config = BiasConfig() if config is None else config
    dataset = dataset if isinstance(dataset, Dataset) else read_dataset(dataset)
    gripper = dataset.gripper()
    config = replace(config, engine=choose_engine(config.engine))
    runs = runs_of(dataset, config.engine, noise_floor=config.noise_floor)
    for engine in {run.engine for run in runs}:
        open_engine(engine)  # refused before anything is run
    settings: Mapping[str, Any] = dataset.info["configuration"]
    trials, trial = int(settings["trials"]), merge(TrialConfig(), settings["trial"])
    choice = choose(dataset, config)
    metric = merge(MetricConfig(), settings["metric"])
    header = {
        "dataset": content_hash(dataset.root / DATASET_FILE),
        "engine": config.engine,
        "reference": dataset.info["engine"],
        "seed": config.seed,
        "gripper": dataset.info["gripper"]["sha256"],
        "grasps": dict(zip(choice.objects, choice.rows, strict=True)),
    }
    with open_study(Path(out), header, metric) as folder:
        tasks = {
            (object_id, run.name): Replay(
                dataset=dataset.root,
                object_id=object_id,
                rows=rows,
                run=run,
                gripper=gripper,
                trials=trials,
                trial=trial,
                metric=metric,
                out=folder.attempt(f"{run.name}.parquet"),
            )
            for object_id, rows in zip(choice.objects, choice.rows, strict=True)
            for run in runs
        }
        failures = run_missing(folder, list(tasks.values()), config.workers, on_progress)
        parts = {
            run.name: read_parts(
                [
                    (folder.root / tasks[object_id, run.name].part, len(rows))
                    for object_id, rows in zip(choice.objects, choice.rows, strict=True)
                ],
                trials=trials,
            )
            for run in runs
        }
        rows = {name: part.rows for name, part in parts.items()}
        comparisons = _comparisons(config, choice, runs, rows)
        study = BiasStudy(
            root=folder.root,
            dataset=dataset,
            config=config,
            choice=choice,
            runs=runs,
            versions={name: part.version for name, part in parts.items()},
            rows=rows,
            engines=comparisons[0],
            floor=tuple(comparisons[1:]),
            disputed=tuple(most_disputed(rows["a"], rows["b"], config.disputed)),
            truth=_truth(runs, gripper, trial) if config.truth else (),
            failures=failures,
            gripper=gripper,
            trials=trials,
        )
        _finish(study, folder)
    return study


def _comparisons(
    config: BiasConfig, choice: Choice, runs: tuple[Run, ...], rows: Mapping[str, RunRows]
) -> list[Comparison]:
    """Every run but the first compared with the first."""
    return [
        compare(
            rows["a"],
            rows[run.name],
            choice.objects,
            choice.index,
            name=run.name,
            labels=(runs[0].label, _told_apart(run, runs)),
            thresholds=config.thresholds,
            seed=config.seed,
            resamples=config.resamples,
        )
        for run in runs[1:]
    ]


def _truth(runs: tuple[Run, ...], gripper: Gripper, config: TrialConfig) -> tuple[TruthRow, ...]:
    """The closed forms on both engines, and on the floor's finer steps."""
    own, other = runs[:2]
    engines = tuple(dict.fromkeys((own.engine, other.engine)))
    rows = truth_table(engines, gripper=gripper, physics=own.physics, config=config)
    finer = [run for run in runs if run.name == "timestep"]
    for run in finer:
        found = truth_table((run.engine,), gripper=gripper, physics=run.physics, config=config)
        rows += tuple(replace(row, engine=run.label) for row in found)
    return rows


def choose(dataset: Dataset, config: BiasConfig) -> Choice:
    """The seeded choice of objects, and of grasps over all scenes of each.

    Raises:
        UsageError: The dataset holds no objects.
    """
    objects = np.array(dataset.objects, dtype=object)
    if len(objects) == 0:
        raise UsageError(f"{dataset.root} holds no objects to replay")
    order = generator(config.seed, "bias", "objects").permutation(len(objects))
    chosen = tuple(sorted(str(object_id) for object_id in objects[order[: config.objects]]))
    rows = []
    for object_id in chosen:
        count = len(dataset.grasps(object_id, columns=("grasp_id",)))
        order = generator(config.seed, "bias", "grasps", object_id).permutation(count)
        rows.append(tuple(sorted(int(row) for row in order[: config.grasps])))
    return Choice(chosen, tuple(rows))


def _told_apart(run: Run, runs: tuple[Run, ...]) -> str:
    """A run's label; where both engines are one, the second says so."""
    return f"{run.label}, again" if run.name == "b" and run.label == runs[0].label else run.label


def _finish(study: BiasStudy, folder: RunFolder) -> None:
    """Write the results from the parts."""
    from gmdx.studies.bias.report import report_html

    choice = study.choice
    with folder.replacing(PAIRS_FILE) as path:
        write_pairs(path, study.dataset, choice.objects, choice.rows, study.runs, study.rows)
    with folder.replacing(STATISTICS_FILE) as path:
        write_text(path, json_text(study.as_json()))
    with folder.replacing(REPORT_FILE) as path:
        write_text(path, report_html(study))
