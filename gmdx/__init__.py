"""Object meshes in, annotated planar-grasp datasets out.

The public names are here; each is imported from its module when it is first used, so that
`import gmdx` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gmdx.dataset.read import Dataset, read_dataset
    from gmdx.dataset.scenes import SceneView
    from gmdx.errors import Failure, GmdxError
    from gmdx.grasps.grasp import PadContacts, PlanarGrasp
    from gmdx.grasps.sample import SampleConfig, sample_grasps
    from gmdx.machine.progress import Progress
    from gmdx.metrics.compute import MetricConfig, MetricTable, compute_metrics
    from gmdx.metrics.epsilon import (
        Epsilon,
        EpsilonBatch,
        Strength,
        directional_strength,
        epsilon,
        epsilon_batch,
        gravity_wrench,
    )
    from gmdx.metrics.quality import Evidence, QualityConfig, Tally
    from gmdx.metrics.table import METRIC_NAMES, METRICS, Metric
    from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
    from gmdx.objects.prepare import PrepareConfig, load_object
    from gmdx.pipeline.generate import GenerateConfig, Summary, generate
    from gmdx.scenes.camera import CameraConfig, DepthImage, render
    from gmdx.scenes.gripper import Gripper, load_gripper
    from gmdx.scenes.scene import Scene
    from gmdx.scenes.settle import SettleConfig, settle
    from gmdx.trials.outcome import Outcome
    from gmdx.trials.protocol import TrialConfig
    from gmdx.trials.results import Snapshot, TrialResults
    from gmdx.trials.run import run_trials

__all__ = [
    "METRICS",
    "METRIC_NAMES",
    "CameraConfig",
    "Dataset",
    "DepthImage",
    "Epsilon",
    "EpsilonBatch",
    "Evidence",
    "Failure",
    "GenerateConfig",
    "GmdxError",
    "Gripper",
    "Metric",
    "MetricConfig",
    "MetricTable",
    "ObjectModel",
    "OrientedBox",
    "Outcome",
    "PadContacts",
    "PlanarGrasp",
    "PrepareConfig",
    "Progress",
    "QualityConfig",
    "SampleConfig",
    "Scene",
    "SceneView",
    "SettleConfig",
    "Snapshot",
    "StablePoses",
    "Strength",
    "Summary",
    "Tally",
    "TrialConfig",
    "TrialResults",
    "compute_metrics",
    "directional_strength",
    "epsilon",
    "epsilon_batch",
    "generate",
    "gravity_wrench",
    "load_gripper",
    "load_object",
    "read_dataset",
    "render",
    "run_trials",
    "sample_grasps",
    "settle",
]

_MODULES = {
    "gmdx.dataset.read": ("Dataset", "read_dataset"),
    "gmdx.dataset.scenes": ("SceneView",),
    "gmdx.errors": ("Failure", "GmdxError"),
    "gmdx.grasps.grasp": ("PadContacts", "PlanarGrasp"),
    "gmdx.grasps.sample": ("SampleConfig", "sample_grasps"),
    "gmdx.machine.progress": ("Progress",),
    "gmdx.metrics.compute": ("MetricConfig", "MetricTable", "compute_metrics"),
    "gmdx.metrics.quality": ("Evidence", "QualityConfig", "Tally"),
    "gmdx.metrics.epsilon": (
        "Epsilon", "EpsilonBatch", "Strength", "directional_strength", "epsilon",
        "epsilon_batch", "gravity_wrench",
    ),
    "gmdx.metrics.table": ("METRICS", "METRIC_NAMES", "Metric"),
    "gmdx.objects.model": ("ObjectModel", "OrientedBox", "StablePoses"),
    "gmdx.objects.prepare": ("PrepareConfig", "load_object"),
    "gmdx.pipeline.generate": ("GenerateConfig", "Summary", "generate"),
    "gmdx.scenes.camera": ("CameraConfig", "DepthImage", "render"),
    "gmdx.scenes.gripper": ("Gripper", "load_gripper"),
    "gmdx.scenes.scene": ("Scene",),
    "gmdx.scenes.settle": ("SettleConfig", "settle"),
    "gmdx.trials.outcome": ("Outcome",),
    "gmdx.trials.protocol": ("TrialConfig",),
    "gmdx.trials.results": ("Snapshot", "TrialResults"),
    "gmdx.trials.run": ("run_trials",),
}  # fmt: skip
_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name, from the module that defines it."""
    if name not in _HOME:
        raise AttributeError(f"module 'gmdx' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
