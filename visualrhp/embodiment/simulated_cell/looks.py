"""Looks of the cell: textures of objects, table and floor, lights, and the printed target disc.

Every texture is a function of a seed and is made with NumPy, so that training frames cost no files.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.objects import CellObject, Rgb

Texture = npt.NDArray[np.uint8]
"""[H, W, 3] RGB; the first row is at v = 0."""

TARGET_RINGS: tuple[tuple[float, Rgb], ...] = ((0.070, (0.05, 0.06, 0.08)), (0.058, (0.10, 0.62, 0.38)))
"""The printed target: discs (radius [m], colour) on top of each other, a green disc with a dark ring."""

_SIZE = 64
_TABLE_SIZE = 256


@dataclass(frozen=True)
class Light:
    """A directional light.

    Attributes:
        direction: in which it shines, world frame; need not have length 1.
        brightness: of its diffuse part.
        casts_shadow: whether bodies cast a shadow.
    """

    direction: tuple[float, float, float] = (0.2, 0.3, -1.0)
    brightness: float = 0.6
    casts_shadow: bool = True


@dataclass(frozen=True)
class CellLook:
    """What the cell looks like, but for its objects.

    Attributes:
        table: seed of the table's texture.
        floor: seed of the floor's texture.
        ambient: brightness of the light from everywhere.
        lights: one to three.
        noise: standard deviation of the camera's noise [grey values of 255].
        blur: standard deviation of the camera's blur [px].
        gain: factor on the image's brightness, one for red, green and blue (white balance).
    """

    table: int = 0
    floor: int = 1
    ambient: float = 0.35
    lights: tuple[Light, ...] = (Light(),)
    noise: float = 2.0
    blur: float = 0.5
    gain: Rgb = (1.0, 1.0, 1.0)


def sample_look(rng: np.random.Generator, noise: tuple[float, float], blur: tuple[float, float]) -> CellLook:
    """A random look.

    Args:
        rng: source of the random numbers.
        noise: range of the standard deviation of the camera's noise [grey values of 255].
        blur: range of the standard deviation of the camera's blur [px].
    """
    count = int(rng.integers(1, 4))
    lights = []
    for number in range(count):
        azimuth, slope = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.9)
        direction = (float(slope * np.cos(azimuth)), float(slope * np.sin(azimuth)), -1.0)
        lights.append(Light(direction, float(rng.uniform(0.35, 0.8)) / count, casts_shadow=number == 0))
    return CellLook(
        table=int(rng.integers(2**31)),
        floor=int(rng.integers(2**31)),
        ambient=float(rng.uniform(0.25, 0.5)),
        lights=tuple(lights),
        noise=float(rng.uniform(*noise)),
        blur=float(rng.uniform(*blur)),
        gain=(float(rng.uniform(0.93, 1.07)), float(rng.uniform(0.96, 1.04)), float(rng.uniform(0.93, 1.07))),
    )


# Textures


def object_texture(thing: CellObject) -> Texture:
    """[H, W, 3] of an object; around its axis to the right, along its profile from the bottom downwards."""
    rng = np.random.default_rng(thing.look)
    colour = thing.colour
    match thing.kind:
        case Kind.APPLE:
            return _apple(colour, rng)
        case Kind.ORANGE:
            return _orange(colour, rng)
        case Kind.CUP:
            return _cup(colour, rng)
        case Kind.BOTTLE:
            return _bottle(colour, rng)
        case Kind.BOX:
            return _box(colour, rng)


def surface_texture(seed: int) -> Texture:
    """[256, 256, 3] of the table or the floor: wood, plain, speckled, cloth or tiles."""
    rng = np.random.default_rng(seed)
    style = int(rng.integers(5))
    base = _hsv(rng, (0.0, 1.0), (0.0, 0.25), (0.25, 0.95))
    if style == 0:
        base = _hsv(rng, (0.05, 0.11), (0.25, 0.6), (0.35, 0.85))
        grain = _noise(rng, (_TABLE_SIZE, 8), _TABLE_SIZE) + 0.5 * _noise(rng, (64, 4), _TABLE_SIZE)
        image = _paint(base, 0.16 * grain)
        image[:: int(rng.integers(40, 90))] *= 0.75
    elif style == 1:
        image = _paint(base, 0.03 * _noise(rng, (4, 4), _TABLE_SIZE))
    elif style == 2:
        image = _paint(base, 0.10 * _noise(rng, (_TABLE_SIZE, _TABLE_SIZE), _TABLE_SIZE))
    elif style == 3:
        x = np.arange(_TABLE_SIZE) * 2.0 * np.pi / int(rng.integers(4, 12))
        weave = 0.5 * (np.sin(x)[:, None] * np.sin(x)[None])
        image = _paint(base, 0.08 * weave + 0.05 * _noise(rng, (6, 6), _TABLE_SIZE))
    else:
        pitch = int(rng.integers(24, 96))
        cells = (np.arange(_TABLE_SIZE) // pitch)[:, None] + (np.arange(_TABLE_SIZE) // pitch)[None]
        image = _paint(base, 0.10 * (cells % 2) + 0.03 * _noise(rng, (64, 64), _TABLE_SIZE))
    return _bytes(image)


def _apple(colour: Rgb | None, rng: np.random.Generator) -> Texture:
    choices = (((0.97, 1.02), (0.75, 0.95), (0.45, 0.8)), ((0.22, 0.29), (0.55, 0.8), (0.5, 0.8)))
    choices += (((0.12, 0.16), (0.55, 0.8), (0.75, 0.95)),)
    base = np.array(colour) if colour else _hsv(rng, *choices[rng.integers(3)])
    other = _hsv(rng, *choices[rng.integers(3)])
    blend = np.clip(
        0.35 * _noise(rng, (5, 5), _SIZE) + 0.12 * _noise(rng, (3, 40), _SIZE) + rng.uniform(-0.3, 0.3), 0, 1
    )
    image = base * (1.0 - blend[..., None]) + other * blend[..., None]
    v = np.linspace(0.0, 1.0, _SIZE)[:, None, None]
    image = image * np.clip(1.1 - 0.7 * np.exp(-((np.minimum(v, 1.0 - v) / 0.06) ** 2)), 0.0, 1.0)
    image[-3:] = (0.25, 0.16, 0.08)  # the stem
    image[:2] = (0.2, 0.14, 0.08)
    return _bytes(image)


def _orange(colour: Rgb | None, rng: np.random.Generator) -> Texture:
    base = np.array(colour) if colour else _hsv(rng, (0.055, 0.10), (0.85, 1.0), (0.8, 1.0))
    image = _paint(base, 0.06 * _noise(rng, (_SIZE, _SIZE), _SIZE) + 0.04 * _noise(rng, (5, 5), _SIZE))
    image[-2:] = (0.35, 0.42, 0.15)
    return _bytes(image)


def _cup(colour: Rgb | None, rng: np.random.Generator) -> Texture:
    base = np.array(colour) if colour else _hsv(rng, (0.0, 1.0), (0.0, 0.85), (0.3, 1.0))
    image = np.broadcast_to(base, (_SIZE, _SIZE, 3)).copy()
    # Along the profile: bottom, outer wall, rim, inner wall, bottom inside.
    if rng.random() < 0.5:
        start = int(rng.integers(14, 26))
        image[start : start + int(rng.integers(3, 9))] = _hsv(rng, (0.0, 1.0), (0.0, 0.9), (0.2, 1.0))
    inside = _hsv(rng, (0.0, 1.0), (0.0, 0.1), (0.75, 1.0)) if rng.random() < 0.6 else base * 0.9
    image[34:] = inside
    if rng.random() < 0.3:  # coffee
        image[56:] = _hsv(rng, (0.04, 0.09), (0.5, 0.9), (0.15, 0.4))
    return _bytes(image + 0.02 * _noise(rng, (16, 16), _SIZE)[..., None])


def _bottle(colour: Rgb | None, rng: np.random.Generator) -> Texture:
    choices = (
        ((0.28, 0.42), (0.4, 0.9), (0.25, 0.6)),
        ((0.53, 0.62), (0.3, 0.8), (0.45, 0.9)),
        ((0.03, 0.08), (0.6, 0.9), (0.2, 0.4)),
        ((0.5, 0.6), (0.03, 0.15), (0.75, 0.95)),
        ((0.0, 1.0), (0.5, 0.9), (0.4, 0.95)),
    )
    base = np.array(colour) if colour else _hsv(rng, *choices[rng.integers(len(choices))])
    image = _paint(base, 0.05 * _noise(rng, (3, 12), _SIZE))
    first, last = int(rng.integers(16, 22)), int(rng.integers(28, 38))
    label = _hsv(rng, (0.0, 1.0), (0.0, 0.9), (0.5, 1.0))
    image[first:last] = label
    print_colour = _hsv(rng, (0.0, 1.0), (0.2, 1.0), (0.1, 0.9))
    for _ in range(int(rng.integers(1, 5))):
        row, column = int(rng.integers(first, last)), int(rng.integers(0, _SIZE - 12))
        image[row : min(row + int(rng.integers(1, 5)), last), column : column + int(rng.integers(4, 24))] = print_colour
    image[-int(rng.integers(8, 13)) :] = _hsv(rng, (0.0, 1.0), (0.0, 0.95), (0.2, 1.0))  # cap
    return _bytes(image)


def _box(colour: Rgb | None, rng: np.random.Generator) -> Texture:
    base = np.array(colour) if colour else _hsv(rng, (0.0, 1.0), (0.0, 0.9), (0.3, 1.0))
    if colour is None and rng.random() < 0.3:  # cardboard
        base = _hsv(rng, (0.07, 0.1), (0.3, 0.5), (0.5, 0.75))
    image = _paint(base, 0.03 * _noise(rng, (24, 24), _SIZE))
    for _ in range(int(rng.integers(0, 6))):
        row, column = rng.integers(0, _SIZE - 8, 2)
        height, width = rng.integers(2, 22, 2)
        image[row : row + height, column : column + width] = _hsv(rng, (0.0, 1.0), (0.0, 1.0), (0.1, 1.0))
    return _bytes(image)


def _hsv(
    rng: np.random.Generator,
    hue: tuple[float, float],
    saturation: tuple[float, float],
    value: tuple[float, float],
) -> npt.NDArray[np.float64]:
    """[3] a random colour; hues from 0 to 1, around the circle."""
    return np.array(colorsys.hsv_to_rgb(rng.uniform(*hue) % 1.0, rng.uniform(*saturation), rng.uniform(*value)))


def _noise(rng: np.random.Generator, grid: tuple[int, int], size: int) -> npt.NDArray[np.float64]:
    """[size, size] smooth noise with about ``grid`` cells, standard deviation about 1."""
    return np.asarray(cv2.resize(rng.standard_normal(grid), (size, size)), dtype=np.float64)


def _paint(base: npt.NDArray[np.float64], variation: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """[H, W, 3] ``base`` [3], lighter and darker by ``variation`` [H, W]."""
    return base * (1.0 + variation[..., None])


def _bytes(image: npt.NDArray[np.float64]) -> Texture:
    return np.clip(np.rint(255.0 * image), 0, 255).astype(np.uint8)
