"""Eq. 2 against scipy, and what the policies of guidances draw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.special import softmax

from visualrhp.heuristics.heuristic import GaussianGuidance, SoftmaxGuidance, UniformGuidance
from visualrhp.types import FloatArray


@given(
    q=arrays.arrays(np.float64, (3, 8), elements=st.floats(-100.0, 0.0)),
    temperature=st.floats(0.05, 20.0),
)
def test_probabilities_are_eq_2(q: FloatArray, temperature: float) -> None:
    guidance = SoftmaxGuidance(q, temperature)
    np.testing.assert_allclose(guidance.probabilities, softmax(q / temperature, axis=1), atol=1e-12)
    np.testing.assert_array_equal(guidance.values, q.max(axis=1))  # v(s) = max q(s, a)


def test_draws_follow_eq_2() -> None:
    q = np.array([[-10.0, -11.0, -12.0, -30.0, -10.5, -13.0, -14.0, -15.0]])
    guidance = SoftmaxGuidance(q.repeat(20_000, axis=0), temperature=2.0)
    rng = np.random.default_rng(0)
    actions = guidance.sample([rng] * 20_000)
    frequencies = np.bincount([int(action) for action in actions], minlength=8) / 20_000
    np.testing.assert_allclose(frequencies, softmax(q[0] / 2.0), atol=0.012)


def test_cold_softmax_draws_the_mode() -> None:
    q = np.random.default_rng(0).uniform(-60.0, 0.0, (50, 8))
    guidance = SoftmaxGuidance(q, temperature=1e-3)
    assert (
        guidance.sample([np.random.default_rng(i) for i in range(50)]) == guidance.mode() == q.argmax(axis=1).tolist()
    )


def test_a_sample_from_values_that_are_not_finite_is_an_action() -> None:
    (action,) = SoftmaxGuidance(np.full((1, 8), np.nan), 1.0).sample([np.random.default_rng(0)])
    assert action in range(8)


def test_a_draw_depends_on_its_own_generator_alone() -> None:
    q = np.random.default_rng(0).uniform(-20.0, 0.0, (4, 8))
    means, stds = np.zeros((4, 4)), np.ones((4, 4))
    for guidance, single in (
        (SoftmaxGuidance(q, 1.0), SoftmaxGuidance(q[2:3], 1.0)),
        (GaussianGuidance(means, stds, np.zeros(4)), GaussianGuidance(means[2:3], stds[2:3], np.zeros(1))),
        (UniformGuidance("continuous", np.zeros(4)), UniformGuidance("continuous", np.zeros(1))),
    ):
        together = guidance.sample([np.random.default_rng(i) for i in range(4)])
        alone = single.sample([np.random.default_rng(2)])
        np.testing.assert_array_equal(together[2], alone[0])


def test_gaussian_draws_have_its_mean_and_deviation() -> None:
    mean, std = np.array([0.5, -0.5, 0.0, 1.0]), np.array([0.05, 0.2, 1.0, 0.5])
    guidance = GaussianGuidance(np.tile(mean, (20_000, 1)), np.tile(std, (20_000, 1)), np.zeros(20_000))
    rng = np.random.default_rng(1)
    actions = np.array(guidance.sample([rng] * 20_000))
    np.testing.assert_allclose(actions.mean(axis=0), mean, atol=0.03)
    np.testing.assert_allclose(actions.std(axis=0), std, rtol=0.03)
    np.testing.assert_array_equal(guidance.mode()[0], mean)


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_uniform_guidance_covers_the_action_space(action_space: str) -> None:
    guidance = UniformGuidance(action_space, np.zeros(400))  # pyright: ignore[reportArgumentType]
    actions = np.array(guidance.sample([np.random.default_rng(i) for i in range(400)]))
    if action_space == "discrete":
        assert set(actions.tolist()) == set(range(8))
    else:
        assert actions.shape == (400, 4)
        assert (np.abs(actions) <= 1.0).all()
        assert (actions.min(axis=0) < -0.9).all() and (actions.max(axis=0) > 0.9).all()
    assert len(guidance.mode()) == 400


def test_taking_rows_gives_their_guidance() -> None:
    q = np.random.default_rng(0).uniform(-20.0, 0.0, (4, 8))
    means, stds = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 4, 4))
    for guidance in (
        SoftmaxGuidance(q, 2.0),
        GaussianGuidance(means, np.abs(stds), np.arange(4.0)),
        UniformGuidance("continuous", np.arange(4.0)),
    ):
        taken = guidance.take([2, 0])
        np.testing.assert_array_equal(taken.values, guidance.values[[2, 0]])
        whole = guidance.sample([np.random.default_rng(i) for i in range(4)])
        part = taken.sample([np.random.default_rng(i) for i in (2, 0)])
        np.testing.assert_array_equal(part, [whole[2], whole[0]])


def test_a_widened_policy_has_the_same_mode_and_values() -> None:
    gaussian = GaussianGuidance(np.full((1, 4), 0.3), np.full((1, 4), 0.2), np.array([-5.0]))
    wide = gaussian.widened(2.0)
    np.testing.assert_array_equal(wide.mode(), gaussian.mode())
    offsets = [guidance.sample([np.random.default_rng(3)])[0] - 0.3 for guidance in (gaussian, wide)]
    np.testing.assert_allclose(offsets[1], 2.0 * offsets[0])
    softmax_guidance = SoftmaxGuidance(np.arange(8.0)[None], 1.0)
    wide_softmax = softmax_guidance.widened(2.0)
    np.testing.assert_allclose(wide_softmax.probabilities, softmax(np.arange(8.0)[None] / 2.0, axis=1))
    np.testing.assert_array_equal(wide_softmax.values, softmax_guidance.values)
    assert wide_softmax.mode() == softmax_guidance.mode()
