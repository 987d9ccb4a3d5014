"""What a run of the whole pipeline is to do."""

from dataclasses import dataclass, field, replace

from gmdx.errors import ConfigError
from gmdx.grasps.sample import SAMPLERS, SampleConfig
from gmdx.metrics.compute import MetricConfig
from gmdx.objects.prepare import CacheOption, PrepareConfig
from gmdx.scenes.camera import CameraConfig
from gmdx.scenes.gripper import DEFAULT_GRIPPER
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.settle import SettleConfig
from gmdx.trials.engines.registry import Chosen, choose
from gmdx.trials.protocol import TrialConfig


@dataclass(frozen=True)
class GenerateConfig:
    """A run of the whole pipeline."""

    grasps: int = 64  # per scene
    scenes: int = 2  # per object, each from a random orientation
    trials: int = 5  # per grasp: the nominal one, and the rest with pose noise
    seed: int = 0  # of every random number
    gripper: str = DEFAULT_GRIPPER  # a shipped gripper's name, or the path of a description
    sampler: str = "dense"  # how grasps are proposed: dense or antipodal
    backend: str = "mujoco"  # what runs the trials: mujoco, mjx, bullet or auto
    impl: str = "auto"  # of mjx: warp, jax or auto
    workers: int = 1  # processes; 1 is this process. Without effect on results
    batch: int = 256  # grasps worked on together: memory against speed. Without effect on results
    batch_size: int | None = None  # trials side by side on mjx; None: what the device has room for
    cache: CacheOption = "user"  # folder of prepared objects; "user": the user's own
    prepare: PrepareConfig = field(default_factory=PrepareConfig)
    settle: SettleConfig = field(default_factory=SettleConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    sample: SampleConfig = field(default_factory=SampleConfig)
    trial: TrialConfig = field(default_factory=TrialConfig)
    metric: MetricConfig = field(default_factory=MetricConfig)

    def __post_init__(self) -> None:
        for name in ("grasps", "scenes", "trials", "workers", "batch"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.batch_size is not None and self.batch_size < 1:
            raise ConfigError(f"batch_size must be at least 1, not {self.batch_size}")
        if self.sampler not in SAMPLERS:
            known = ", ".join(SAMPLERS)
            raise ConfigError(f"unknown sampler {self.sampler!r}; give one of {known}")
        if self.batch_size is not None and self.backend in ("mujoco", "bullet"):
            raise ConfigError(f"batch_size is of backend 'mjx', not of {self.backend!r}")
        choose(self.backend, self.impl)
        if self.trial.trials not in (TrialConfig().trials, self.trials):
            raise ConfigError("set `trials` of the whole run, not of [trial]")
        if self.settle.physics not in (PhysicsConfig(), self.trial.physics):
            raise ConfigError("set [trial.physics], which settling shares, not [settle.physics]")
        if self.metric.quality.patch_radius != self.trial.physics.torsion_radius:
            raise ConfigError(
                "[metric.quality] patch_radius and [trial.physics] torsion_radius are one length, "
                "the radius of a contact's patch: set both to the same"
            )

    @property
    def chosen(self) -> Chosen:
        """The backend that the names stand for on this machine."""
        return choose(self.backend, self.impl)

    def resolved(self) -> "GenerateConfig":
        """The same run with what stages share, and what `auto` stands for, written into each."""
        return replace(
            self,
            backend=self.chosen.backend,
            impl="auto" if self.chosen.impl is None else self.chosen.impl,
            batch_size=None if self.chosen.impl is None else self.batch_size,
            trial=replace(self.trial, trials=self.trials),
            settle=replace(self.settle, physics=self.trial.physics),
            sample=replace(self.sample, lines=self.sample.lines.resolved()),
            metric=self.metric.resolved(),
        )
