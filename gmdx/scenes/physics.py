"""How contacts and steps are computed: one setting, which a scene carries to all that follows."""

from dataclasses import dataclass

import numpy as np

from gmdx.errors import ConfigError

GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class PhysicsConfig:
    """How contacts and steps are computed; the closed forms in the tests hold at the defaults.

    Sliding friction is the object's own.
    """

    timestep: float = 0.004  # s
    cone: str = "elliptic"  # of friction; pyramids are refused, see `__post_init__`
    impratio: float = 10.0  # stiffness of friction over that of the normal: small lets grips creep
    patch_radius: float = 0.005  # m, of a soft finger's contact patch, which resists torsion
    solref: tuple[float, float] = (0.01, 1.0)  # s, damping ratio, of contacts
    solimp: tuple[float, float, float] = (0.99, 0.999, 0.001)  # of contacts: 0.1 mm deep at 20 N
    iterations: int = 50  # of the contact solver, at most
    ls_iterations: int = 30  # of its line search, at most
    tolerance: float = (
        1e-12  # MuJoCo's own 1e-8 lets a light box slide on a slope it should stick to
    )
    drive_frequency: float = 150.0  # rad/s, of the servo that moves the gripper up and down
    drive_force: float = 300.0  # N, that servo's limit
    closing_speed: float = 0.15  # m/s, of each finger while nothing resists it
    closing_acceleration: float = 30.0  # m/s^2, of a free finger: sets the drive's inertia
    memory: int = 2**24  # bytes for contacts and constraints; a trial that needs more fails by name

    def __post_init__(self) -> None:
        if self.cone == "pyramidal":
            raise ConfigError(
                "physics: pyramidal friction cones are refused: forces between the edges of the "
                "pyramid are too small (a 0.5 kg box held by two pads came out at 0.81 of the "
                "closed form when pushed sideways, in C MuJoCo and in Warp alike); use elliptic"
            )
        if self.cone != "elliptic":
            raise ConfigError(f"physics: unknown cone {self.cone!r}; give elliptic")
        for name, value in vars(self).items():
            if name != "cone" and not np.all((np.asarray(value) > 0) & np.isfinite(value)):
                raise ConfigError(f"physics: {name} must be positive and finite, got {value}")

    def torsion(self, friction: float) -> float:
        """Torsional friction of a contact (m): its largest moment over its normal force.

        That of a round patch under even pressure, 2/3 x friction x radius.

        Args:
            friction: The sliding coefficient.
        """
        return 2.0 / 3.0 * friction * self.patch_radius
