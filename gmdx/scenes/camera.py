"""Depth images of a scene, drawn by scan lines on the CPU: no GL, no window."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float, Int, UInt8
from gmdx.errors import ConfigError, UsageError
from gmdx.scenes.scene import Scene

TABLE = 0
OBJECT = 1

# World axes of a camera that looks straight down, as columns: x right, -y down the image, -z ahead.
_DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class CameraConfig:
    """A pinhole camera aimed at the world's origin, in one or several views.

    View 0 looks straight down: world x points right in the image and world y points up.
    The others stand on a ring: as far from the origin, tilted from the vertical by `tilt`,
    at even azimuths (view 1 on the side of +x), and not rolled. With the defaults the image
    covers 0.42 m x 0.32 m of the table, 0.66 mm a pixel: a 20 cm bottle fills two thirds of
    its height.
    """

    width: int = 640  # pixels
    height: int = 480  # pixels
    field_of_view: float = 0.6109  # rad, vertical (35 degrees)
    distance: float = 0.5  # m, of the camera from the world's origin
    views: int = 1  # images of a scene
    tilt: float = 0.35  # rad, of views 1, 2, ... from the vertical

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or self.views < 1:
            raise ConfigError(
                f"camera: width, height and views must be at least 1, "
                f"got {self.width}, {self.height}, {self.views}"
            )
        if not (0 < self.field_of_view < np.pi and self.distance > 0 and self.tilt >= 0):
            raise ConfigError(
                f"camera: field_of_view must be in (0, pi), distance positive and tilt not "
                f"negative, got {self.field_of_view}, {self.distance}, {self.tilt}"
            )
        half = np.arctan(np.hypot(1, self.width / self.height) * np.tan(self.field_of_view / 2))
        if half + (self.tilt if self.views > 1 else 0.0) > np.radians(85):
            raise ConfigError(
                "camera: tilt and field_of_view together see the horizon; make either smaller"
            )


@dataclass(frozen=True)
class DepthImage:
    """What one view of a scene shows. Pixel (row i, column j) has its centre at (u, v) = (j, i).

    The camera's frame is OpenCV's: x right, y down, z forward. A point p of the camera's frame
    is seen at intrinsics @ p / p_z.
    """

    depth: Float[Array, "H W"]  # m, float32, along the optical axis
    segmentation: UInt8[Array, "H W"]  # 0 table, 1 object
    intrinsics: Float[Array, "3 3"]  # pixels
    pose: Float[Array, "4 4"]  # camera to world, m


def intrinsics(config: CameraConfig) -> Float[Array, "3 3"]:
    """The pinhole matrix, in pixels; the optical axis goes through the image's middle."""
    f = config.height / 2 / np.tan(config.field_of_view / 2)
    return np.array([[f, 0, (config.width - 1) / 2], [0, f, (config.height - 1) / 2], [0, 0, 1.0]])


def camera_pose(view: int, config: CameraConfig) -> Float[Array, "4 4"]:
    """The camera's pose in `view`, camera to world.

    Raises:
        UsageError: `config` has no such view.
    """
    if not 0 <= view < config.views:
        raise UsageError(
            f"view {view} does not exist: the camera has the views 0 to {config.views - 1}; "
            "raise CameraConfig.views"
        )
    turn = np.eye(3)
    if view > 0:
        azimuth = 2 * np.pi * (view - 1) / (config.views - 1)
        c, s = np.cos(azimuth), np.sin(azimuth)
        towards = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        ct, st = np.cos(config.tilt), np.sin(config.tilt)
        lean = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
        turn = towards @ lean @ towards.T
    pose = np.eye(4)
    pose[:3, :3] = turn @ _DOWN
    pose[:3, 3] = config.distance * turn[:, 2]
    return pose


def render(scene: Scene, *, view: int = 0, config: CameraConfig | None = None) -> DepthImage:
    """Depth and segmentation of a scene, as seen from one view.

    Args:
        scene: The scene.
        view: Which of the configured views.
        config: The camera; the default one looks straight down.

    Returns:
        The image; where the object's surface dips under the table, the table is seen.

    Raises:
        UsageError: There is no such view.
        ConfigError: The object reaches up to the camera.
    """
    config = CameraConfig() if config is None else config
    K, pose = intrinsics(config), camera_pose(view, config)
    # 1 / depth is linear in the image: that of the table is a plane over u and v.
    down = pose[2, :3] @ np.linalg.inv(K) / -pose[2, 3]
    table = down[0] * np.arange(config.width) + down[1] * np.arange(config.height)[:, None]
    table += down[2]

    points = (scene.to_world(scene.object.vertices) - pose[:3, 3]) @ pose[:3, :3]
    if points[:, 2].min() < 0.01 * config.distance:
        raise ConfigError(
            f"object {scene.object.object_id!r} in scene {scene.scene_id} reaches up to the "
            f"camera at {config.distance} m: raise CameraConfig.distance"
        )
    pixels = points @ K.T
    pixels = np.column_stack([pixels[:, :2], np.ones(len(pixels))]) / points[:, 2:]
    surface = _rasterize(pixels, scene.object.faces, config.height, config.width)
    return DepthImage(
        depth=(1 / np.maximum(surface, table)).astype(np.float32),
        segmentation=np.where(surface > table, OBJECT, TABLE).astype(np.uint8),
        intrinsics=K,
        pose=pose,
    )


def _rasterize(
    points: Float[Array, "v 3"], faces: Int[Array, "f 3"], height: int, width: int
) -> Float[Array, "height width"]:
    """The largest 1 / depth of the triangles over each pixel's centre; 0 where there is none.

    By scan lines: a pixel belongs to a triangle where the triangle, cut by the pixel's row,
    spans its column. Where an edge crosses a row is computed in one way for both triangles
    that share the edge, and spans are half open, so a closed surface shows no cracks.

    Args:
        points: u and v, pixels, and 1 / depth, 1/m.
        faces: Vertices of each triangle, in either winding.
        height: Rows of the image.
        width: Columns of the image.
    """
    triangles = points[faces]
    order = np.argsort(triangles[:, :, 1], axis=1, kind="stable")
    triangles = np.take_along_axis(triangles, order[:, :, None], axis=1)  # by v
    first = np.clip(np.ceil(triangles[:, 0, 1]), 0, height).astype(int)
    end = np.clip(np.ceil(triangles[:, 2, 1]), 0, height).astype(int)

    triangle, row = _ranges(first, end)
    upper, middle, lower = np.moveaxis(triangles[triangle], 1, 0)
    above = (row < middle[:, 1])[:, None]
    long_side = _crossing(upper, lower, row)
    short_side = _crossing(np.where(above, upper, middle), np.where(above, middle, lower), row)
    swap = (long_side[:, 0] > short_side[:, 0])[:, None]
    left, right = np.where(swap, short_side, long_side), np.where(swap, long_side, short_side)

    first = np.clip(np.ceil(left[:, 0]), 0, width).astype(int)
    end = np.clip(np.ceil(right[:, 0]), 0, width).astype(int)
    span, column = _ranges(first, end)
    slope = (right[:, 1] - left[:, 1]) / np.where(end > first, right[:, 0] - left[:, 0], 1.0)
    nearness = left[span, 1] + (column - left[span, 0]) * slope[span]

    image = np.zeros(height * width)
    np.maximum.at(image, row[span] * width + column, nearness)
    return image.reshape(height, width)


def _ranges(
    first: Int[Array, "n"], end: Int[Array, "n"]
) -> tuple[Int[Array, "m"], Int[Array, "m"]]:
    """The integers first[i] <= k < end[i] of all i, with the i of each: (i, k)."""
    count = np.maximum(end - first, 0)
    index = np.repeat(np.arange(len(first)), count)
    return index, np.arange(len(index)) + np.repeat(first - np.cumsum(count) + count, count)


def _crossing(
    a: Float[Array, "n 3"], b: Float[Array, "n 3"], row: Int[Array, "n"]
) -> Float[Array, "n 2"]:
    """U and 1 / depth where the line from a to b crosses v = row."""
    share = ((row - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
    crossing: Array = a[:, ::2] + share * (b[:, ::2] - a[:, ::2])
    return crossing
