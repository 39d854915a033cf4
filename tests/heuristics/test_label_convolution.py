"""The fast first layer is the slow one: colours, coordinates, convolution and pooling, computed one after the other."""

from __future__ import annotations

import pytest
import torch

from tests.heuristics.plain_convolution import PlainLabelConvolution
from visualrhp.heuristics.label_convolution import LabelConvolution
from visualrhp.observation.label_image import IMAGE_SIZE, label_image
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.streams import Split


def blobs(generator: torch.Generator) -> torch.Tensor:
    """[8, 64, 64] labels: areas of one label, as in label images, and noise in the last two."""
    coarse = torch.randint(6, (6, 8, 8), generator=generator, dtype=torch.uint8)
    noise = torch.randint(6, (2, IMAGE_SIZE, IMAGE_SIZE), generator=generator, dtype=torch.uint8)
    areas = coarse.repeat_interleave(8, 1).repeat_interleave(8, 2).roll((2, 3), (1, 2))
    return torch.cat([areas, noise])


def real_images() -> torch.Tensor:
    tasks = [sample_task_instance(SceneDistribution(), 0, Split.TUNING, index) for index in range(6)]
    return torch.stack([torch.from_numpy(label_image(task.scene, task.state)) for task in tasks])


@pytest.mark.parametrize("kind", ["blobs", "images", "uniform"])
def test_values_and_gradients_are_those_of_the_plain_convolution(kind: str) -> None:
    generator = torch.Generator().manual_seed(3)
    torch.manual_seed(3)
    layer = LabelConvolution(8).double()
    uniform = torch.arange(6, dtype=torch.uint8)[:, None, None].repeat(1, IMAGE_SIZE, IMAGE_SIZE)
    labels = {"blobs": blobs(generator), "images": real_images(), "uniform": uniform}[kind]
    upstream = torch.randn(len(labels), 8, 16, 16, generator=generator, dtype=torch.float64)
    gradients = []
    outputs = [layer(labels), layer.plain(labels), PlainLabelConvolution(layer)(labels)]
    for output in outputs:
        layer.zero_grad()
        output.backward(upstream)
        gradients.append([parameter.grad for parameter in layer.parameters()])
    for output, gradient in zip(outputs[:2], gradients[:2], strict=True):
        torch.testing.assert_close(output, outputs[2], rtol=1e-6, atol=1e-6)
        for ours, expected in zip(gradient, gradients[2], strict=True):
            torch.testing.assert_close(ours, expected, rtol=1e-5, atol=1e-5)


def test_large_batches_are_the_same_images_one_by_one() -> None:
    layer = LabelConvolution(4)
    labels = blobs(torch.Generator().manual_seed(1)).repeat(130, 1, 1)[:1030]  # more than two chunks
    with torch.no_grad():
        torch.testing.assert_close(layer(labels)[1020:], layer(labels[1020:]))


def test_output_has_the_channels_last_in_memory() -> None:
    assert LabelConvolution(8)(blobs(torch.Generator())).is_contiguous(memory_format=torch.channels_last)
