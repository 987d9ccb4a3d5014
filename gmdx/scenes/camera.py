"""Depth images of a scene by ray casting: no GL, no window, no GPU."""

from dataclasses import dataclass

import mujoco
import numpy as np

from gmdx.arrays import Array, Float, UInt8
from gmdx.errors import ConfigError, UsageError
from gmdx.objects.model import ObjectModel
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
    views: int = 1
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


class DepthCamera:
    """Renders scenes of one object, whose surface is compiled for ray casting once."""

    def __init__(self, obj: ObjectModel, config: CameraConfig | None = None) -> None:
        self.object = obj
        self.config = CameraConfig() if config is None else config
        self._model, self._data = _compile_surface(obj)

    def render(self, scene: Scene, *, view: int = 0) -> DepthImage:
        """Depth and segmentation of `scene`.

        Args:
            scene: The scene; its object must be this camera's.
            view: Which of the configured views.

        Returns:
            The image; where the surface dips under the table, the table is seen.

        Raises:
            UsageError: The scene shows another object, or there is no such view.
            ConfigError: The object reaches up to the camera.
        """
        if scene.object is not self.object:
            raise UsageError(
                f"this camera renders object {self.object.object_id!r}, not "
                f"{scene.object.object_id!r}: make a DepthCamera for each object"
            )
        K, pose = intrinsics(self.config), camera_pose(view, self.config)
        R, eye = pose[:3, :3], pose[:3, 3]
        u = (np.arange(self.config.width) - K[0, 2]) / K[0, 0]
        v = (np.arange(self.config.height) - K[1, 2]) / K[1, 1]

        # Ray of pixel (i, j): eye + depth * (u_j, v_i, 1), in the camera's frame.
        descent = R[2, 0] * u[None, :] + R[2, 1] * v[:, None] + R[2, 2]
        depth = (-eye[2] / descent).astype(np.float32)
        segmentation = np.zeros(depth.shape, np.uint8)

        rows, columns = self._window(scene, K, pose)
        if rows.start < rows.stop and columns.start < columns.stop:
            nearest = self._cast(scene, pose, u[columns], v[rows])
            seen = nearest < depth[rows, columns]
            depth[rows, columns][seen] = nearest[seen]
            segmentation[rows, columns][seen] = OBJECT
        return DepthImage(depth=depth, segmentation=segmentation, intrinsics=K, pose=pose)

    def _window(
        self, scene: Scene, K: Float[Array, "3 3"], pose: Float[Array, "4 4"]
    ) -> tuple[slice, slice]:
        """Rows and columns of the image between which all of the object lies."""
        turn = pose[:3, :3].T @ scene.rotation
        points = self.object.vertices @ turn.T + (scene.position - pose[:3, 3]) @ pose[:3, :3]
        nearest = points[:, 2].min()
        if nearest < 0.01 * self.config.distance:
            raise ConfigError(
                f"object {self.object.object_id!r} in scene {scene.scene_id} reaches up to the "
                f"camera at {self.config.distance} m: raise CameraConfig.distance"
            )
        pixels = points[:, :2] / points[:, 2:] * K[0, 0] + K[:2, 2]
        first = np.floor(pixels.min(axis=0)).astype(int)
        last = np.ceil(pixels.max(axis=0)).astype(int)
        (left, top) = np.maximum(first, 0)
        right = min(last[0], self.config.width - 1)
        bottom = min(last[1], self.config.height - 1)
        return slice(int(top), int(bottom) + 1), slice(int(left), int(right) + 1)

    def _cast(
        self,
        scene: Scene,
        pose: Float[Array, "4 4"],
        u: Float[Array, "w"],
        v: Float[Array, "h"],
    ) -> Float[Array, "h w"]:
        """Depth of the surface along the rays (u_j, v_i, 1), m; infinite where there is none."""
        rays = np.empty((len(v), len(u), 3))
        rays[..., 0] = u
        rays[..., 1] = v[:, None]
        rays[..., 2] = 1.0
        # The surface stays where it was compiled; the camera moves into the object's frame.
        rays = rays.reshape(-1, 3) @ (scene.rotation.T @ pose[:3, :3]).T
        eye = scene.to_object(pose[:3, 3])
        geom = np.empty(len(rays), np.int32)
        # Distances come in units of the ray's length, and a ray is 1 long along the optical axis.
        depth = np.empty(len(rays))
        mujoco.mj_multiRay(
            self._model,
            self._data,
            eye,
            rays.reshape(-1),
            None,
            True,
            -1,
            geom,
            depth,
            None,
            len(rays),
            mujoco.mjMAXVAL,
        )
        depth[geom < 0] = np.inf
        return depth.reshape(len(v), len(u))


def render(scene: Scene, *, view: int = 0, config: CameraConfig | None = None) -> DepthImage:
    """Depth and segmentation of one scene; for many scenes of an object, use a DepthCamera.

    Args:
        scene: The scene.
        view: Which of the configured views.
        config: The camera; the default one looks straight down.

    Raises:
        UsageError: There is no such view.
        ConfigError: The object reaches up to the camera.
    """
    return DepthCamera(scene.object, config).render(scene, view=view)


def _compile_surface(obj: ObjectModel) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A model that holds the object's surface alone, in the object's frame."""
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(
        name="surface", uservert=obj.vertices.ravel(), userface=obj.faces.astype(np.int32).ravel()
    )
    # Nothing moves here, and a shell's inertia exists for every surface.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="surface", contype=0, conaffinity=0
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data
