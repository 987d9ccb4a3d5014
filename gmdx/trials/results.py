"""What an engine found about some grasps."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.gripper import Gripper


class Snapshot(IntEnum):
    """When the nominal trial's poses are recorded: index into the snapshot axis."""

    START = 0  # the object at rest, the gripper above it
    CLOSING = 1  # end of approach, start of closing
    CLOSED = 2  # end of closing, start of lift
    HELD = 3  # end of the hold


@dataclass(frozen=True)
class TrialResults:
    """Results of n grasps with t trials each; trial 0 is the nominal one.

    What the nominal trial did not reach is NaN (poses, opening, force) or invalid
    (contacts). Poses are of the object's frame in the world of the scene.
    """

    grasp_id: Int[Array, "n"]  # of the grasps, in their order
    gripper: Gripper  # that executed them
    outcome: Int[Array, "n t"]  # values of `Outcome`
    collision: Bool[Array, "n t"]  # something other than a pad's face touched before closing
    object_position: Float[Array, "n 4 3"]  # m, nominal trial, by Snapshot
    object_quaternion: Float[Array, "n 4 4"]  # wxyz, nominal trial, by Snapshot
    tool_position: Float[Array, "n 4 3"]  # m, nominal trial, by Snapshot
    contacts: PadContacts  # nominal trial, in the object's frame, at CLOSED
    opening: Float[Array, "n"]  # m, between the pads at CLOSED, from the joints
    push_force: Float[Array, "n"]  # N, that pushed it out; 0 if not lifted, or if it slipped
    # out by itself; NaN if the trial or its push diverged
    push_force_is_lower_bound: Bool[Array, "n"]  # the ramp ended before the object came out
    engine: str  # which one ran, with its version
    steps: int  # physics steps over all trials
    step_seconds: float  # s, inside the engine's step
    seconds: float  # s, in all

    def __len__(self) -> int:
        return len(self.outcome)

    def __getitem__(self, rows: slice) -> "TrialResults":
        """Some of the grasps, with their share of the steps and seconds."""
        share = len(self.outcome[rows]) / max(len(self), 1)
        return replace(
            self,
            **{item.name: getattr(self, item.name)[rows] for item in fields(self)
               if item.name not in _WHOLE},
            steps=round(self.steps * share),
            step_seconds=self.step_seconds * share,
            seconds=self.seconds * share,
        )  # fmt: skip


def joined_results(parts: Sequence[TrialResults]) -> TrialResults:
    """Results of more grasps by one engine and gripper, one record after the other."""
    sums: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in _SUMS}
    contacts = [part.contacts for part in parts]
    arrays: dict[str, Any] = {
        item.name: np.concatenate([getattr(part, item.name) for part in parts])
        for item in fields(TrialResults)
        if item.name not in (*_WHOLE, "contacts")
    }
    joined = PadContacts(
        points=np.concatenate([pads.points for pads in contacts]),
        normals=np.concatenate([pads.normals for pads in contacts]),
        valid=np.concatenate([pads.valid for pads in contacts]),
    )
    return replace(parts[0], **arrays, **sums, contacts=joined)


_SUMS = ("steps", "step_seconds", "seconds")
_WHOLE = ("gripper", "engine", *_SUMS)  # not a row a grasp
