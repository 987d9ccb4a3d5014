"""Planar grasps, and the contacts of two pads, as batches."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int


@dataclass(frozen=True)
class PlanarGrasp:
    """A batch of top-down parallel-jaw grasps, in the world's frame."""

    grasp_id: Int[Array, "n"]  # unique in its scene; names the grasp in every random key
    center: Float[Array, "n 3"]  # m, of the gripper's tool point: midway between the pads
    angle: Float[Array, "n"]  # rad in [0, pi), of the closing axis about world z
    width: Float[Array, "n"]  # m, opening between the pads before closing

    def __len__(self) -> int:
        return len(self.grasp_id)

    def __getitem__(self, index: slice | Int[Array, "m"] | Bool[Array, "n"]) -> "PlanarGrasp":
        """The grasps at `index` (a slice, indices or a mask), as a batch."""
        return PlanarGrasp(
            self.grasp_id[index], self.center[index], self.angle[index], self.width[index]
        )

    @property
    def axis(self) -> Float[Array, "n 3"]:
        """Unit closing axes in the world: from pad 0 (negative side) to pad 1."""
        return np.stack([np.cos(self.angle), np.sin(self.angle), np.zeros(len(self))], axis=1)


@dataclass(frozen=True)
class PadContacts:
    """Contact points of both pads for a batch of grasps, in the object's frame.

    Pad 0 lies on the negative side of the closing axis and pad 1 on the positive side.
    Slots past a pad's last contact are invalid and hold NaN.
    """

    points: Float[Array, "n 2 k 3"]  # m
    normals: Float[Array, "n 2 k 3"]  # unit, into the object
    valid: Bool[Array, "n 2 k"]

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: slice | Int[Array, "m"] | Bool[Array, "n"]) -> "PadContacts":
        """The contacts of the grasps at `index`, as a batch."""
        return PadContacts(self.points[index], self.normals[index], self.valid[index])

    @property
    def both(self) -> Bool[Array, "n"]:
        """Whether both pads have a contact."""
        touched: Array = self.valid.any(axis=2)  # type: ignore[assignment]
        return np.logical_and(touched[:, 0], touched[:, 1])

    @property
    def means(self) -> Float[Array, "n 2 3"]:
        """Mean contact point of each pad, m; NaN for a pad without contact."""
        count = self.valid.sum(axis=2)[..., None]
        total = np.where(self.valid[..., None], self.points, 0.0).sum(axis=2)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)
