"""Parameters of our segmentation network: its frames, its size and its training. This module does not import torch."""

from __future__ import annotations

from typing import Annotated

from visualrhp.parameters import AsTuple, Count, Field, Fraction, NonNegative, Positive, parameters


@parameters(kw_only=True)
class FrameSampling:
    """How frames are taken of a cell.

    Attributes:
        frames_per_cell: frames of each cell; before each but the first the arm moves, and pushes what is in its way.
        motions: most motions before each frame.
        grasp: probability that a motion opens or closes the fingers.
        settle_s: time after the motions [s]; objects may still roll.
        on_target: probability that the target region is printed where an object is, as at the end of a task: some look
            like it.
    """

    frames_per_cell: Count = 3
    motions: Count = 3
    grasp: Fraction = 0.25
    settle_s: NonNegative = 0.2
    on_target: Fraction = 0.5


@parameters
class NetworkConfig:
    """Size of the network.

    Attributes:
        widths: channels of the stem (half the resolution of the input), and of the stages after it, each of half the
            resolution of the previous one.
        blocks: residual blocks of each stage.
        decoder_width: channels of the decoder.
        fine_width: channels of its last layer, which has the resolution of the stem.
    """

    widths: Annotated[tuple[Count, ...], AsTuple] = (16, 24, 48, 96, 128)
    blocks: Annotated[tuple[Count, ...], AsTuple] = (1, 2, 2, 1)
    decoder_width: Count = 32
    fine_width: Count = 16

    def __post_init__(self) -> None:
        if len(self.blocks) != len(self.widths) - 1 or len(self.blocks) < 2:
            raise ValueError(
                f"blocks={list(self.blocks)} should have one number for each of the {len(self.widths) - 1} stages "
                "after the stem, of which there are at least two."
            )


@parameters
class Augmentation:
    """How much frames are changed.

    Attributes:
        brightness: largest factor of the light, and of its reciprocal, less 1.
        colour: largest factor of each of the three channels, and of its reciprocal, less 1.
        contrast: largest exponent of the grey values, and of its reciprocal, less 1.
        blur: probability of a blur, with a standard deviation of at most 1 pixel.
        noise: largest standard deviation of added noise [grey values].
        turn: whether frames are turned by multiples of a right angle, and mirrored.
    """

    brightness: NonNegative = 0.35
    colour: NonNegative = 0.12
    contrast: NonNegative = 0.25
    blur: Fraction = 0.3
    noise: Annotated[float, Field(ge=0, le=100)] = 8.0
    turn: bool = True


@parameters
class SegmenterTrainingConfig:
    """Parameters of the training.

    Attributes:
        epochs: passes over the frames.
        batch_size: frames of a step.
        lr: highest learning rate of AdamW; after a share ``warm_up`` of the steps, in which it rises, it falls to zero
            along a cosine.
        warm_up: see ``lr``.
        weight_decay: of AdamW.
        validation_fraction: share of held-out frames, the last ones.
        augmentation: of the training frames.
    """

    epochs: Count = 30
    batch_size: Count = 8
    lr: Positive = 2e-3
    warm_up: Annotated[float, Field(ge=0, lt=1)] = 0.05
    weight_decay: NonNegative = 1e-4
    validation_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.05
    augmentation: Augmentation = Augmentation()
