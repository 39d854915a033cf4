"""What is seen of a state: the abstract image and the Cartesian features that networks read, frames and videos."""

from visualrhp.rendering.cartesian import cartesian_dimension, cartesian_features, mirror_cartesian
from visualrhp.rendering.label_image import IMAGE_SIZE, PALETTE, Label, colour_image, label_image, mirror_image

__all__ = [
    "IMAGE_SIZE",
    "PALETTE",
    "Label",
    "cartesian_dimension",
    "cartesian_features",
    "colour_image",
    "label_image",
    "mirror_cartesian",
    "mirror_image",
]
