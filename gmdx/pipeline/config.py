"""What a run of the whole pipeline is to do."""

from dataclasses import dataclass, field, replace

from gmdx.errors import ConfigError
from gmdx.grasps.sample import DEFAULT_SAMPLER, SAMPLERS, SampleConfig
from gmdx.metrics.compute import MetricConfig
from gmdx.objects.prepare import CacheOption, PrepareConfig
from gmdx.scenes.camera import CameraConfig
from gmdx.scenes.gripper import DEFAULT_GRIPPER
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.settle import SettleConfig
from gmdx.trials.engines import DEFAULT_ENGINE, ENGINES, choose
from gmdx.trials.protocol import TRIALS, TrialConfig


@dataclass(frozen=True)
class GenerateConfig:
    """A run of the whole pipeline."""

    grasps: int = 64  # per scene
    scenes: int = 2  # per object, each from a random orientation
    trials: int = TRIALS  # per grasp: the nominal one, and the rest with pose noise
    seed: int = 0  # of every random number
    gripper: str = DEFAULT_GRIPPER  # a shipped gripper's name, or the path of a description
    sampler: str = DEFAULT_SAMPLER  # how grasps are proposed: dense or antipodal
    engine: str = DEFAULT_ENGINE  # what runs the trials: mujoco, warp, bullet or auto
    workers: int = 1  # processes; 1 is this process. Without effect on results
    block: int = 256  # grasps worked on together: memory against speed. Without effect on results
    parallel_trials: int | None = None  # side by side on a device; None: what it has room for
    cache: CacheOption = "user"  # folder of prepared objects; "user": the user's own
    prepare: PrepareConfig = field(default_factory=PrepareConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)  # of settling, trials and metrics
    settle: SettleConfig = field(default_factory=SettleConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    sample: SampleConfig = field(default_factory=SampleConfig)
    trial: TrialConfig = field(default_factory=TrialConfig)
    metric: MetricConfig = field(default_factory=MetricConfig)

    def __post_init__(self) -> None:
        for name in ("grasps", "scenes", "trials", "workers", "block"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.parallel_trials is not None and self.parallel_trials < 1:
            raise ConfigError(f"parallel_trials must be at least 1, not {self.parallel_trials}")
        if self.sampler not in SAMPLERS:
            known = ", ".join(SAMPLERS)
            raise ConfigError(f"unknown sampler {self.sampler!r}; give one of {known}")
        choose(self.engine)
        named = ENGINES.get(self.engine)  # `auto` has none
        if self.parallel_trials is not None and named is not None and not named.parallel:
            names = " or ".join(name for name, entry in ENGINES.items() if entry.parallel)
            raise ConfigError(f"parallel_trials is of the engine {names}, not of {self.engine!r}")

    def resolved(self) -> "GenerateConfig":
        """The same run with what `auto` stands for on this machine."""
        engine = choose(self.engine)
        return replace(
            self,
            engine=engine,
            parallel_trials=self.parallel_trials if ENGINES[engine].parallel else None,
            metric=self.metric.resolved(),
        )
