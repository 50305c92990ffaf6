"""Statistics over seeds and over their episodes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from ogmp_sb3.evaluation.seeds import few_seeds_text, seed_statistics
from ogmp_sb3.evaluation.statistics import estimate

ANY = (None, None)


def draws(*means: float, n: int = 60, spread: float = 1.0) -> list[list[float]]:
    """Episodes of some seeds."""
    rng = np.random.default_rng(7)
    return [rng.normal(mean, spread, n).tolist() for mean in means]


def test_the_mean_and_the_interval_over_seeds_are_those_of_what_each_seed_came_to() -> None:
    values = [[1.0, 3.0], [5.0, 7.0], [0.0, 4.0]]  # means 2, 6, 2
    found = seed_statistics(values, ANY, True).over_seeds
    expected = stats.ttest_1samp([2.0, 6.0, 2.0], 0.0).confidence_interval(0.95)
    assert (found.mean, found.n) == (pytest.approx(10 / 3), 3)
    assert (found.low, found.high) == (pytest.approx(expected.low), pytest.approx(expected.high))


def test_more_episodes_leave_the_interval_over_seeds_as_it_is() -> None:
    few = [[1.0, 3.0], [5.0, 7.0], [0.0, 4.0]]
    many = [of_seed * 50 for of_seed in few]
    short, long = (seed_statistics(values, ANY, True) for values in (few, many))
    assert short.over_seeds == long.over_seeds
    assert (short.over_episodes.n, long.over_episodes.n) == (6, 300)


def test_the_interquartile_mean_is_that_of_the_middle_half_of_all_episodes() -> None:
    """4, 5, 6 and 7 are the middle half of eight; the greatest counts no more than any other of the upper quarter."""
    found = seed_statistics([[1.0, 4.0, 6.0, 9.0], [2.0, 5.0, 7.0, 1000.0]], ANY, True)
    assert (found.over_episodes.mean, found.over_episodes.n, found.number) == (5.5, 8, "iqm")
    assert found.over_seeds.mean == pytest.approx((5.0 + 253.5) / 2)


def bootstrap(values: list[list[float]], together: bool) -> np.ndarray:
    """Percentiles of interquartile means, drawn one by one."""
    rng, found = np.random.default_rng(1), []
    samples = [np.array(of_seed) for of_seed in values]
    for _ in range(3000):
        picked = rng.integers(len(samples[0]), size=len(samples[0]))
        drawn = [x[picked] if together else x[rng.integers(len(x), size=len(x))] for x in samples]
        ordered = np.sort(np.concatenate(drawn))
        cut = len(ordered) // 4
        found.append(ordered[cut : len(ordered) - cut].mean())
    return np.percentile(found, [2.5, 97.5])


@pytest.mark.parametrize("same_tracks", [True, False])
def test_the_interval_over_episodes_is_a_bootstrap_within_each_seed(same_tracks: bool) -> None:
    values = draws(0.0, 0.5, 3.0)
    found = seed_statistics(values, ANY, same_tracks).over_episodes
    np.testing.assert_allclose([found.low, found.high], bootstrap(values, same_tracks), atol=0.03)
    again = seed_statistics(values, ANY, same_tracks).over_episodes
    assert again == found  # nothing is left to chance


def test_what_tells_seeds_apart_does_not_lengthen_the_interval_over_episodes() -> None:
    found = seed_statistics(draws(0.0, 10.0, spread=0.01), ANY, False)
    assert found.over_episodes.mean == pytest.approx(5.0, abs=0.01)
    assert found.over_episodes.high - found.over_episodes.low < 0.02  # type: ignore[operator]
    assert found.over_seeds.high - found.over_seeds.low > 100  # type: ignore[operator]  # of two


def test_a_track_that_is_hard_for_all_seeds_counts_as_one() -> None:
    (one,) = draws(0.0, n=200)
    lengths = [
        found.high - found.low  # type: ignore[operator]
        for found in (seed_statistics([one] * 4, ANY, same).over_episodes for same in (True, False))
    ]
    assert lengths[0] / lengths[1] == pytest.approx(np.sqrt(4), rel=0.1)


def test_of_yes_or_no_it_is_the_share_with_wilson_s_interval() -> None:
    values = [[True] * 9 + [False], [True] * 10, [True] * 8 + [False] * 2]
    found = seed_statistics(values, ANY, True)
    assert found.number == "share"
    assert found.over_episodes == estimate([True] * 27 + [False] * 3)
    assert found.over_seeds.mean == pytest.approx(0.9)
    assert found.over_seeds.high == 1.0  # not beyond: 0.9 + 4.3 * 0.1 / sqrt(3)
    assert found.over_seeds.low == pytest.approx(0.9 - 4.302653 * 0.1 / np.sqrt(3))


def test_seeds_that_never_fall_do_not_show_that_none_ever_will() -> None:
    found = seed_statistics([[True] * 50] * 3, ANY, True)
    assert (found.over_seeds.mean, found.over_seeds.high) == (1.0, 1.0)
    assert found.over_seeds.low == pytest.approx(estimate([True] * 3).low)
    assert found.over_episodes.low == pytest.approx(estimate([True] * 150).low)


def test_seeds_may_have_different_numbers_of_episodes() -> None:
    found = seed_statistics([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0]], ANY, False)
    assert (found.over_episodes.n, found.over_episodes.mean) == (6, pytest.approx(3.5))  # 2, 3, 4, 5
    assert (found.over_seeds.n, found.over_seeds.mean) == (2, pytest.approx((2.5 + 5.5) / 2))


def test_one_seed_has_no_interval_over_seeds() -> None:
    found = seed_statistics(draws(1.0), ANY, True)
    assert (found.over_seeds.n, found.over_seeds.low, found.over_seeds.high) == (1, None, None)
    assert found.over_episodes.low is not None


def test_one_episode_of_a_seed_shows_nothing_of_how_much_they_vary() -> None:
    found = seed_statistics([[1.0], [2.0, 3.0]], ANY, False).over_episodes
    assert (found.mean, found.n, found.low, found.high) == (2.0, 3, None, None)


def test_episodes_that_came_to_the_same_have_no_interval() -> None:
    found = seed_statistics([[10.0] * 20, [10.0] * 19 + [4.0]], (None, 10.0), True).over_episodes
    assert (found.mean, found.low, found.high) == (10.0, None, None)


@pytest.mark.parametrize(("seeds", "reach"), [(2, 12.7062 / 2**0.5), (3, 4.3027 / 3**0.5), (4, 3.1824 / 2.0)])
def test_few_seeds_are_said_to_be(seeds: int, reach: float) -> None:
    text = few_seeds_text(seeds)
    assert text.startswith(f"{seeds} seeds are few: the interval over seeds reaches {reach:.1f} standard deviations")
    assert "(1.2 for 5 seeds, 0.7 for 10)" in text


def test_one_seed_is_said_to_be_one_and_five_need_no_words() -> None:
    assert few_seeds_text(1).startswith("One seed is one training: there is no interval over seeds")
    assert few_seeds_text(5) == ""
