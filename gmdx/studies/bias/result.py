"""What a bias study is asked for, and what it found."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gmdx.arrays import Array, Int
from gmdx.config import as_dict
from gmdx.dataset.read import Dataset
from gmdx.errors import ConfigError, Failure
from gmdx.scenes.gripper import Gripper
from gmdx.studies.bias.compare import Comparison
from gmdx.studies.bias.replay import Run, RunRows
from gmdx.studies.engines import TruthRow


@dataclass(frozen=True)
class BiasConfig:
    """What a bias study does."""

    objects: int | None = None  # chosen by the seed; None: all of the dataset
    grasps: int | None = 32  # of each object, chosen by the seed; None: all
    seed: int = 0  # of the choice and of the resampling
    engine: str = "bullet"  # the second engine
    noise_floor: bool = True  # also run the dataset's engine against itself
    truth: bool = True  # also compare both engines with closed forms
    thresholds: tuple[float, ...] = (0.6, 0.8, 1.0)  # of the success share, for labels
    resamples: int = 2000  # of each bootstrap interval
    disputed: int = 6  # grasps that the engines disagree about most, to draw
    workers: int = 1  # processes; 1 is this process. Without effect on results

    def __post_init__(self) -> None:
        for name in ("objects", "grasps", "resamples", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigError(f"{name} must be at least 1, not {value}")
        if not self.thresholds or not all(0 < t <= 1 for t in self.thresholds):
            raise ConfigError(f"thresholds must be some in (0, 1], not {self.thresholds}")
        if self.disputed < 0:
            raise ConfigError(f"disputed must not be negative, as {self.disputed} is")


@dataclass(frozen=True)
class Choice:
    """The grasps of a study: n of them, of some objects."""

    objects: tuple[str, ...]
    rows: tuple[tuple[int, ...], ...]  # by object: of its table

    @property
    def index(self) -> Int[Array, "n"]:
        """Which object each grasp is of."""
        return np.repeat(np.arange(len(self.objects)), [len(rows) for rows in self.rows])


@dataclass(frozen=True)
class BiasStudy:
    """A finished study: what ran, and what it came to."""

    root: Path
    dataset: Dataset
    config: BiasConfig
    choice: Choice
    runs: tuple[Run, ...]
    trials: int  # of each grasp in each run
    versions: Mapping[str, str]  # by run: the engine's name and version
    rows: Mapping[str, RunRows]  # by run
    engines: Comparison  # the second engine against the first
    floor: tuple[Comparison, ...]  # the first engine against itself, a way each
    disputed: tuple[int, ...]  # grasps, as rows of the study
    truth: tuple[TruthRow, ...]
    failures: tuple[Failure, ...]  # replays that could not be run
    gripper: Gripper

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The engines' first, then the noise floor's."""
        return (self.engines, *self.floor)

    def as_json(self) -> dict[str, Any]:
        """All statistics."""
        return {
            "configuration": as_dict(self.config, leave_out=("workers",)),
            "dataset": {"name": self.dataset.root.name, "seed": self.dataset.info["seed"]},
            "objects": list(self.choice.objects),
            "grasps": int(sum(len(rows) for rows in self.choice.rows)),
            "runs": [
                {"name": run.name, "label": run.label, "engine": self.versions[run.name]}
                for run in self.runs
            ],
            "engines": asdict(self.engines),
            "noise_floor": [asdict(comparison) for comparison in self.floor],
            "truth": [asdict(row) for row in self.truth],
            "failures": [asdict(failure) for failure in self.failures],
        }
