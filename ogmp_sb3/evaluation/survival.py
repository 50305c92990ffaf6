"""How far robots get on tracks without end: the share of episodes that still run, over the distance and over time.

An episode that ends as far along as was asked for, or by its time limit, is censored: its robot would have fallen
later. Survival curves allow for that (Kaplan and Meier 1958), where a mean or a median of the distances would count
such an episode as if it had ended by a fall. The intervals of the shares are Greenwood's, on the scale of log(-log),
and that of the median is Brookmeyer and Crowley's: the places where the interval of the share holds one half.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from ogmp_sb3.evaluation.metrics import no_fall_fraction
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.evaluation.statistics import as_text

DISTANCE, TIME = "distance_m", "time_s"
ROUNDING = 1e-9


class Share(NamedTuple):
    """The share of episodes that still run at a place of a curve."""

    at: float
    """the place"""
    share: float
    """estimated share of episodes that run beyond it"""
    low: float | None
    """lower end of its 95 % interval over episodes; None where there is none: at 1 and at 0"""
    high: float | None
    """upper end"""
    running: int
    """episodes that got as far as this place: what the curve rests on there"""


@dataclass(frozen=True)
class Survival:
    """A survival curve."""

    steps: tuple[Share, ...]
    """where episodes ended, ascending; the share holds from there to the next"""
    n: int
    """episodes"""
    falls: int
    """of these, how many ended before their time; the others are censored"""
    median: float | None
    """where half of the robots have fallen; None if fewer have"""
    low: float | None
    """lower end of its 95 % interval over episodes; None: there is none"""
    high: float | None
    """upper end"""

    def share_at(self, place: float) -> Share:
        """The share of episodes that run beyond a place."""
        passed = [step for step in self.steps if step.at <= place]
        last = passed[-1] if passed else Share(0.0, 1.0, None, None, self.n)
        return last._replace(at=place, running=next((step.running for step in self.steps if step.at >= place), 0))

    def as_data(self) -> dict[str, Any]:
        """Plain data, as in JSON files: the steps as one list for each number."""
        columns = {name: [getattr(step, name) for step in self.steps] for name in Share._fields}
        return {**asdict(self), "steps": columns}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Survival:
        """The curve that :meth:`as_data` gave.

        :raises KeyError: if something is missing
        """
        columns = [data["steps"][name] for name in Share._fields]
        steps = tuple(Share(*step) for step in zip(*columns, strict=True))
        return cls(**{**data, "steps": steps})


def survival_curve(ends: Sequence[float], fell: Sequence[bool]) -> Survival:
    """The survival curve of some episodes.

    :param ends: where each ended, at least one
    :param fell: whether by a fall; the others are censored there
    """
    from scipy.stats import CensoredData, ecdf  # imported here: it takes a second

    place, fall = np.asarray(ends, dtype=float), np.asarray(fell, dtype=bool)
    curve = ecdf(CensoredData(uncensored=place[fall], right=place[~fall])).sf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of shares of 1 and 0, which have no interval
        interval = curve.confidence_interval(0.95, method="log-log")
    low, high = (_known(end.probabilities) for end in (interval.low, interval.high))
    at, share = curve.quantiles.tolist(), curve.probabilities.tolist()
    running = [int((place >= x).sum()) for x in at]
    steps = tuple(map(Share, at, share, low, high, running))
    first = (next((x for x, share in zip(at, end, strict=True) if share is not None and share <= 0.5), None)
             for end in (low, high))  # fmt: skip
    return Survival(steps, len(place), int(fall.sum()), _median(steps), *first)


def _known(values: np.ndarray) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values.tolist()]


def _median(steps: Sequence[Share]) -> float | None:
    """Where the share falls to one half; if it stays there for a while, half way to the next fall."""
    for i, step in enumerate(steps):
        if step.share < 0.5 + ROUNDING:
            lower = [later.at for later in steps[i:] if later.share < 0.5 - ROUNDING]
            return 0.5 * (step.at + lower[0]) if step.share > 0.5 - ROUNDING and lower else step.at
    return None


def survival_curves(records: Sequence[EpisodeRecord]) -> dict[str, Survival]:
    """Survival over the distance along the track, m, and over time, s.

    The distance is the greatest that the robot reached.

    :return: by :data:`DISTANCE` and :data:`TIME`; none unless tracks have no end
    """
    if any(record.track_length is not None or record.calls[0].segment().timed for record in records):
        return {}
    fell = [not no_fall_fraction(record) for record in records]
    distance = [float(record.base_pos_w[:, 0].max() - record.base_pos_w[0, 0]) for record in records]
    time = [record.steps * record.control_dt for record in records]
    return {DISTANCE: survival_curve(distance, fell), TIME: survival_curve(time, fell)}


def round_places(end: float) -> list[float]:
    """Round places up to an end: 1, 2, 5, 10, 20, ...; at most six, the farthest.

    :param end: above 0
    """
    powers = range(-2, math.ceil(math.log10(max(end, 1.0))) + 1)
    return [digit * 10.0**power for power in powers for digit in (1, 2, 5) if digit * 10.0**power <= end][-6:]


def median_text(curve: Survival, unit: str) -> str:
    """The median with its interval.

    :param unit: of the places
    """
    if curve.median is None:
        return f"over {curve.steps[-1].at:.1f} {unit} (more than half still run where the last episode ends)"
    ends = (as_text([curve.low], 1), "open" if curve.high is None else as_text([curve.high], 1))
    return f"{curve.median:.1f} {unit} (95 % interval over episodes: {' .. '.join(ends)})"


def survival_table(curves: dict[str, Survival]) -> Table:
    """How many robots still run at round distances, as Rich prints it."""
    curve = curves[DISTANCE]
    table = Table(title="episodes that still run, by distance", title_justify="left")
    for column in ("m", "share", "95 % interval over episodes", "got so far"):
        table.add_column(column, justify="right")
    for place in round_places(curve.steps[-1].at):
        at = curve.share_at(place)
        table.add_row(f"{place:g}", as_text([at.share]), as_text([at.low, at.high], 3, " .. "), str(at.running))
    return table
