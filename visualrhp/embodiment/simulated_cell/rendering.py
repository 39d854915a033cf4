"""Pictures of the simulated cell: what its camera sees, which body each pixel shows, and the view from the side."""

from __future__ import annotations

import functools
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.camera import Camera
from visualrhp.embodiment.packages import robot_package
from visualrhp.embodiment.simulated_cell.looks import CellLook
from visualrhp.errors import ConfigError

Image = npt.NDArray[np.uint8]

MARGIN: Final = 24
"""Pixels that are rendered around the image of a camera with lens distortion, which moves pixels inwards."""

SIDE_VIEW_SIZE: Final = (640, 480)
"""Width and height of the view from the side [px]."""

GL_PACKAGES: Final = "libegl1 libegl-mesa0 libgl1-mesa-dri"
"""Debian's packages with which MuJoCo renders without a screen or a graphics card."""


def rendered_size(camera: Camera) -> tuple[int, int]:
    """Width and height of the image that MuJoCo renders for a camera, before its lens distorts it [px]."""
    margin = 2 * MARGIN if camera.distortion.any() else 0
    return camera.width + margin, camera.height + margin


class CellRenderer:
    """Renders a model of a cell.

    Args:
        model: of :func:`visualrhp.embodiment.simulated_cell.model.cell_model`.
        camera: the true one.

    Raises:
        ConfigError: there is no OpenGL library.
    """

    def __init__(self, model: Any, camera: Camera) -> None:
        self._mujoco = robot_package("mujoco")
        self._model, self._camera = model, camera
        self._maps = _distortion_maps(camera) if camera.distortion.any() else None
        width, height = rendered_size(camera)
        self._main = self._renderer(width, height)
        self._side = None

    def _renderer(self, width: int, height: int) -> Any:
        try:
            return self._mujoco.Renderer(self._model, height, width)
        except Exception as error:  # whatever the GL library raises: an OSError, an AttributeError, a RuntimeError
            raise ConfigError(
                f"MuJoCo cannot render ({type(error).__name__}: {error!s:.200}). Without a screen it needs an OpenGL "
                f"library with EGL: on Debian and Ubuntu, apt-get install {GL_PACKAGES}; the environment variable "
                "MUJOCO_GL should be egl, or osmesa or glfw if you use these."
            ) from error

    def image(self, data: Any) -> Image:
        """[H, W, 3] what a perfect sensor behind the lens sees, RGB."""
        self._main.update_scene(data, "camera")
        return self._through_lens(self._main.render(), cv2.INTER_LINEAR)

    def geoms(self, data: Any) -> npt.NDArray[np.int32]:
        """[H, W] index of the geom that each pixel shows; -1 where there is none."""
        self._main.update_scene(data, "camera")
        self._main.enable_segmentation_rendering()
        try:
            found = self._main.render()
        finally:
            self._main.disable_segmentation_rendering()
        is_geom = found[..., 1] == int(self._mujoco.mjtObj.mjOBJ_GEOM)
        ids = np.where(is_geom, found[..., 0], -1).astype(np.int16)
        return self._through_lens(ids, cv2.INTER_NEAREST).astype(np.int32)

    def side_view(self, data: Any) -> Image:
        """[480, 640, 3] the cell from the side, RGB."""
        if self._side is None:
            self._side = self._renderer(*SIDE_VIEW_SIZE)
        self._side.update_scene(data, "side")
        return self._side.render()

    def close(self) -> None:
        """Release the contexts; closing twice has no effect."""
        for renderer in (self._main, self._side):
            if renderer is not None:
                renderer.close()
        self._side = None

    def _through_lens(self, image: Any, interpolation: int) -> Any:
        if self._maps is None:
            return image
        return cv2.remap(image, *self._maps, interpolation)


@functools.lru_cache(maxsize=8)
def _distortion_maps(camera: Camera) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Where each pixel of the distorted image lies in the rendered one, [H, W] columns and rows."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    ideal = cv2.undistortPoints(pixels, camera.intrinsics, camera.distortion, P=camera.intrinsics)
    ideal = ideal.reshape(camera.height, camera.width, 2).astype(np.float32) + MARGIN
    return ideal[..., 0].copy(), ideal[..., 1].copy()


def expose(image: Image, look: CellLook, rng: np.random.Generator) -> Image:
    """[H, W, 3] the image of a real sensor: white balance, blur and noise.

    Args:
        image: [H, W, 3] RGB.
        look: of the cell.
        rng: source of the noise.
    """
    exposed = image.astype(np.float32) * np.array(look.gain, dtype=np.float32)
    if look.blur > 0.0:
        exposed = cv2.GaussianBlur(exposed, (0, 0), look.blur)
    if look.noise > 0.0:
        exposed += np.float32(look.noise) * rng.standard_normal(exposed.shape, dtype=np.float32)
    return np.clip(np.rint(exposed), 0, 255).astype(np.uint8)
