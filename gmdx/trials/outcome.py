"""How a trial ended."""

from enum import IntEnum

import numpy as np

from gmdx.arrays import Array, Bool, Int


class Outcome(IntEnum):
    """The named end of one trial; every trial has exactly one."""

    SUCCESS = 0  # lifted and held between both pads
    NO_CONTACT = 1  # the fingers closed without touching the object
    LOST_IN_LIFT = 2  # between both pads when they had closed, but not held at the end
    KNOCKED_AWAY = 3  # touched, but not between both pads when they had closed
    COLLISION_IN_APPROACH = 4  # the gripper hit the object or the table on its way down
    DIVERGED = 5  # the simulation failed; says nothing about the grasp
    OVERFLOWED = 6  # too many contacts for the engine's buffers; says nothing about the grasp

    @property
    def label(self) -> str:
        """The name in datasets and tables: lower case, with underscores."""
        return self.name.lower()

    @staticmethod
    def is_failure(outcome: Int[Array, "*n"]) -> Bool[Array, "*n"]:
        """Where the simulation failed, so that the outcome says nothing about the grasp."""
        failed: Array = np.isin(outcome, (Outcome.DIVERGED, Outcome.OVERFLOWED))
        return failed
