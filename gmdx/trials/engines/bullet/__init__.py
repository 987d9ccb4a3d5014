"""Trials on PyBullet: the small reference, an engine that shares no code with MuJoCo."""

from gmdx.trials.engines.bullet.engine import BulletEngine
from gmdx.trials.engines.bullet.world import BulletConfig

__all__ = [
    "BulletConfig",
    "BulletEngine",
]
