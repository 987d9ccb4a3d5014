"""The errors that gmdx raises: each says what was wrong, where, and what to do."""

from dataclasses import dataclass


class GmdxError(Exception):
    """Base of every error that gmdx raises on purpose."""


class UsageError(GmdxError):
    """The caller asked for something that does not exist or does not fit together."""


class ConfigError(UsageError):
    """A configuration file or value is not valid."""


class CatalogError(UsageError):
    """An object specification names nothing that can be read."""


class MeshError(GmdxError):
    """A mesh could not be read, or could not be made into a closed surface."""


class DecompositionError(GmdxError):
    """A mesh could not be approximated by convex hulls."""


class GripperError(GmdxError):
    """A gripper's description or its MJCF model is not usable."""


class SceneError(GmdxError):
    """An object did not come to rest on the table."""


class GraspError(GmdxError):
    """No grasp could be sampled, or a batch of grasps is malformed."""


class DeviceMemoryError(GmdxError):
    """An accelerator has no memory left for a batch of this size."""


class MetricError(GmdxError):
    """A metric was given values that it is not defined for."""


class DatasetError(GmdxError):
    """A dataset on disk could not be written, continued or read."""


@dataclass(frozen=True)
class Failure:
    """An object or a scene that was not produced, and why."""

    object_id: str
    scene_id: int | None  # None: the whole object
    stage: str  # of the pipeline: prepare, settle, sample, trials, metrics, render, write, worker
    error: str  # class of the error
    message: str

    @property
    def key(self) -> tuple[str, int, str, str]:
        """Order in `failures.jsonl`: by object, the object's own line first."""
        scene = -1 if self.scene_id is None else self.scene_id
        return (self.object_id, scene, self.stage, self.message)

    def __str__(self) -> str:
        scene = "" if self.scene_id is None else f", scene {self.scene_id}"
        return f"{self.object_id}{scene}: {self.stage} failed: {self.message}"
