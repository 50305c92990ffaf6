"""Rungs of a search: candidates train to a rung, are compared there, and go on to the next or stop.

The rules are pure functions of the scores so far. So a candidate that stopped goes on later if the rule says so by
then: this is what asynchronous successive halving does (Li et al., "A system for massively parallel hyperparameter
tuning", MLSys 2020). Brackets are those of Hyperband (Li et al., JMLR 18, 2018): each begins one rung later to stop
candidates; shares of candidates as in Optuna's ``HyperbandPruner``.
"""

from __future__ import annotations

import math
import statistics
import zlib
from collections.abc import Mapping, Sequence
from typing import Literal

Pruner = Literal["halving", "hyperband", "median"]

STARTUP = 5  # candidates at a rung, up to which the median stops none


def budgets(total: int, rungs: int, reduction: int) -> list[int]:
    """Samples at each rung, each ``reduction`` times those before; the last are ``total``.

    :raises ValueError: if the first rung has none
    """
    found = [total // reduction**left for left in reversed(range(rungs))]
    if found[0] < 1:
        raise ValueError(
            f"'total_timesteps' is {total:,}: too few for {rungs} rungs, each with {reduction} times the samples "
            "of the one before."
        )
    return found


def goes_on(
    rule: Pruner | None,
    scores: Mapping[str, Sequence[float]],
    candidate: str,
    rungs: int,
    reduction: int,
    at_least_one: bool,
) -> bool:
    """Whether a candidate trains on to the next rung.

    :param rule: None: always. ``halving``: if it is among the best ``1/reduction`` of those that reached its rung.
        ``median``: if no more of them are better than are worse. ``hyperband``: as ``halving``, within its bracket
    :param scores: of every candidate, one for each rung it has reached, the first rung first; more is better
    :param candidate: one of them, which has reached a rung
    :param rungs: how many there are
    :param at_least_one: the best goes on, however few there are
    """
    rung = len(scores[candidate]) - 1
    peers = {name: reached[rung] for name, reached in scores.items() if len(reached) > rung}
    if rule is None:
        return True
    if rule == "median":
        return len(peers) <= STARTUP or peers[candidate] >= statistics.median(peers.values())
    if rule == "hyperband":
        own = bracket(candidate, rungs, reduction)
        if rung < own:
            return True
        peers = {name: score for name, score in peers.items() if bracket(name, rungs, reduction) == own}
    ranked = sorted(peers, key=lambda name: -peers[name])  # the first to come is ahead of others with its score
    return candidate in ranked[: max(len(ranked) // reduction, int(at_least_one))]


def bracket(candidate: str, rungs: int, reduction: int) -> int:
    """The rung at which a candidate is compared first, by its name: most begin at rung 0."""
    shares = [math.ceil(rungs * reduction**left / (left + 1)) for left in reversed(range(rungs))]
    place = zlib.crc32(candidate.encode()) % sum(shares)
    return next(i for i in range(rungs) if place < sum(shares[: i + 1]))
