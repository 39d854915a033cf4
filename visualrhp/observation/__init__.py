"""Observations, the input of networks: the abstract label image (Sec. 5.1) and Cartesian features (Sec. 7.5)."""

from visualrhp.observation.cartesian import CartesianObservation
from visualrhp.observation.label_image import IMAGE_SIZE, PALETTE, Label, LabelImageObservation, colour_image
from visualrhp.observation.observation import (
    Observation,
    ObservationStore,
    make_observation,
    observation_class,
    observation_for,
)

__all__ = [
    "IMAGE_SIZE",
    "PALETTE",
    "CartesianObservation",
    "Label",
    "LabelImageObservation",
    "Observation",
    "ObservationStore",
    "colour_image",
    "make_observation",
    "observation_class",
    "observation_for",
]
