"""Statistics over trainings that differ in the seed alone: two kinds of interval, which answer two questions.

- Over seeds: what another training of the same settings would come to. The number is the mean over the seeds of what
  each came to, the interval Student's, and ``n`` is the number of seeds.
- Over episodes: what these very policies would come to on other tracks. The number is the interquartile mean over all
  episodes of all seeds (IQM: the mean of the middle half), the interval a bootstrap stratified by seed, as in rliable
  (Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice), and ``n`` is the number
  of episodes. Of what is yes or no in each episode the middle half says nothing: there it is the share of all episodes,
  with Wilson's interval.

However many episodes are played, they say nothing on another seed; and of one seed, there is no interval over seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from ogmp_sb3.evaluation.statistics import Estimate, Limits, estimate

FEW = 5  # seeds: fewer are few, and are said to be
RESAMPLES = 2000  # of a bootstrap
SHARE = (0.0, 1.0)  # limits of a share


@dataclass(frozen=True)
class SeedStatistics:
    """What trainings that differ in the seed alone came to in one metric."""

    over_seeds: Estimate
    """mean over the seeds of the mean of each, with the interval over seeds; ``n`` counts seeds"""
    over_episodes: Estimate
    """interquartile mean over all episodes, or share of them, with the interval over episodes; ``n`` counts episodes"""
    number: str
    """what that is: ``iqm`` or ``share``"""


def seed_statistics(values: Sequence[Sequence[float]], limits: Limits, same_tracks: bool) -> SeedStatistics:
    """Statistics of a metric over seeds, and over all their episodes.

    :param values: of each seed, the metric of each of its episodes; yes or no as ``bool``
    :param limits: of the metric
    :param same_tracks: whether episode ``i`` of every seed is on the same track. They are then drawn together in the
        bootstrap: a hard track is hard for the policy of each seed
    """
    pooled = [value for of_seed in values for value in of_seed]
    yes_or_no = all(isinstance(value, bool) for value in pooled)
    means = [float(np.mean(of_seed)) for of_seed in values]
    over_seeds = estimate(means, SHARE if yes_or_no else limits)
    if yes_or_no:
        return SeedStatistics(over_seeds, estimate(pooled), "share")
    return SeedStatistics(over_seeds, _middle(values, same_tracks), "iqm")


def _middle(values: Sequence[Sequence[float]], same_tracks: bool) -> Estimate:
    """The interquartile mean over all episodes of all seeds, with its bootstrap interval.

    There is no interval if a seed has one episode alone, or if the middle half is the same in every draw: that shows
    nothing of how much it varies.
    """
    from scipy.stats import bootstrap, trim_mean  # imported here: it takes a second

    samples = [np.array(of_seed, dtype=float) for of_seed in values]
    pooled = np.concatenate(samples)

    def middle(*draws: np.ndarray, axis: int = -1) -> np.ndarray:
        means: np.ndarray = trim_mean(np.concatenate(draws, axis=axis), 0.25, axis=axis)
        return means

    std = float(pooled.std(ddof=1)) if len(pooled) > 1 else None
    low = high = None
    if min(map(len, samples)) > 1:
        drawn = bootstrap(
            samples, middle, n_resamples=RESAMPLES, paired=same_tracks, vectorized=True, method="percentile",
            confidence_level=0.95, random_state=np.random.default_rng(0), batch=1000,
        ).confidence_interval  # fmt: skip
        if drawn.low < drawn.high:
            low, high = float(drawn.low), float(drawn.high)
    return Estimate(float(middle(pooled)), std, len(pooled), low, high)


def few_seeds_text(seeds: int) -> str:
    """A sentence on how little some seeds say of another one; empty for :data:`FEW` or more."""
    if seeds == 1:
        return "One seed is one training: there is no interval over seeds, and what another would give is not known."
    if seeds >= FEW:
        return ""
    return (
        f"{seeds} seeds are few: the interval over seeds reaches {_reach(seeds):.1f} standard deviations to each side "
        f"of the mean ({_reach(FEW):.1f} for {FEW} seeds, {_reach(10):.1f} for 10), and the deviation is hardly known."
    )


def _reach(seeds: int) -> float:
    """Half the length of Student's interval over the standard deviation."""
    return float(stdtrit(seeds - 1, 0.975) / np.sqrt(seeds))
