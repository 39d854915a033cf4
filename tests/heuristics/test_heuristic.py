"""Eq. 2 against scipy, and what the policies of guidances draw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.special import log_softmax, softmax

from visualrhp.heuristics.heuristic import GaussianGuidance, Guidance, SoftmaxGuidance, UniformGuidance
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


# ------------------------------------------------------------------------------------------- without replacement
@given(
    q=arrays.arrays(np.float64, (1, 8), elements=st.floats(-100.0, 0.0)),
    count=st.integers(1, 12),
    tried=st.sets(st.integers(0, 7)),
)
def test_distinct_discrete_actions_prefer_those_that_were_not_tried(q: FloatArray, count: int, tried: set[int]) -> None:
    for guidance in (SoftmaxGuidance(q, 1.0), UniformGuidance("discrete", np.zeros(1))):
        actions = guidance.sample_distinct(count, tried, np.random.default_rng(0))
        assert len(set(actions)) == len(actions) == min(count, 8)
        assert [action in tried for action in actions] == sorted(action in tried for action in actions)
        assert set(range(8)) - tried <= set(actions) or not tried & set(actions)


def test_the_first_distinct_action_follows_eq_2_and_the_second_eq_2_without_it() -> None:
    q = np.array([[-1.0, -2.0, -3.0, -30.0, -30.0, -30.0, -30.0, -30.0]])
    rng = np.random.default_rng(0)
    pairs = np.array([SoftmaxGuidance(q, 2.0).sample_distinct(2, (), rng) for _ in range(20_000)])
    expected = softmax(q[0] / 2.0)
    np.testing.assert_allclose(np.bincount(pairs[:, 0], minlength=8) / 20_000, expected, atol=0.012)
    after_0 = pairs[pairs[:, 0] == 0, 1]
    rest = np.where(np.arange(8) == 0, 0.0, expected) / (1.0 - expected[0])
    np.testing.assert_allclose(np.bincount(after_0, minlength=8) / len(after_0), rest, atol=0.015)


def test_distinct_actions_of_values_that_are_not_finite_are_actions() -> None:
    actions = SoftmaxGuidance(np.full((1, 8), np.nan), 1.0).sample_distinct(3, (), np.random.default_rng(0))
    assert len(set(actions)) == 3 and set(actions) <= set(range(8))


@pytest.mark.parametrize(
    "guidance",
    [GaussianGuidance(np.zeros((1, 4)), np.ones((1, 4)), np.zeros(1)), UniformGuidance("continuous", np.zeros(1))],
)
def test_continuous_samples_are_distinct_as_they_are(guidance: Guidance) -> None:
    actions = guidance.sample_distinct(3, (), np.random.default_rng(0))
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(actions, [guidance.sample([rng])[0] for _ in range(3)])


@given(q=arrays.arrays(np.float64, (1, 8), elements=st.floats(-100.0, 0.0)), temperature=st.floats(0.05, 20.0))
def test_log_probability_is_eq_2(q: FloatArray, temperature: float) -> None:
    guidance = SoftmaxGuidance(q, temperature)
    ours = [guidance.log_probability(action) for action in range(8)]
    np.testing.assert_allclose(ours, log_softmax(q[0] / temperature), atol=1e-9)
    assert UniformGuidance("discrete", np.zeros(1)).log_probability(3) == 0.0
