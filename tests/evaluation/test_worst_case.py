"""The weakest point: the box that is searched, and that what makes a robot fall is found."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.evaluation import worst_case
from ogmp_sb3.evaluation.analysis import Request

BOX = {
    "push": {"speed": [0.0, 6.0], "every": [0.1, 0.2]},
    "mass": {"scale": [0.95, 1.05]},
    "friction": {"coefficient": 0.9},
}


class Standing:
    """A policy that holds the nominal pose."""

    def predict(self, observation: np.ndarray, *_: object, **__: object) -> tuple[np.ndarray, None]:
        return np.zeros((len(observation), 10)), None


def request(randomisation: object) -> Request:
    keys = {"evaluation.episode_steps": 12, "modes.jump": None, "modes.leap": None, "curriculum": None}
    task = load_task("parkour", {**keys, "randomisation": randomisation})
    return Request(
        policy=Standing(),
        task=task.for_evaluation(),
        training_task=task,
        trained_task=task,
        value=True,
        episodes=2,
        seed=0,
        max_distance=None,
    )


def test_the_box_has_an_axis_for_every_range_that_says_how_much() -> None:
    task = request(BOX).training_task
    axes = worst_case.box(task)
    assert [(axis.name, axis.low, axis.high) for axis in axes] == [("push.speed", 0.0, 6.0), ("mass.scale", 0.95, 1.05)]
    point = worst_case.disturbed(task, axes, [3.0, 1.01])
    assert point["push"] == {"speed": Range(3.0, 3.0), "every": Range(0.1, 0.2)}
    assert point["mass"] == {"scale": Range(1.01, 1.01)}
    assert point["friction"] == {"coefficient": Range(0.9, 0.9)}


def test_without_a_range_there_is_nothing_to_look_through() -> None:
    with pytest.raises(ValueError, match="'worst_case' looks through the ranges of 'randomisation', and there is none"):
        worst_case.box(request({"friction": {"coefficient": 0.9}}).training_task)


def test_hard_pushes_are_found_to_be_what_makes_a_robot_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worst_case, "POINTS", 32)
    monkeypatch.setattr(worst_case, "WORST", 3)
    monkeypatch.setattr(worst_case, "AGAIN", 2)
    steps: list[int] = []
    asked = request(BOX)
    report = worst_case.measure_worst_case(asked, steps.append)
    assert len(report["points"]) == 32 and len(report["worst"]) == 3
    speed, mass = report["influence"]
    assert speed < -0.5 and abs(mass) < 0.4
    assert report["worst"][0]["values"][0] > 3.0
    shares = [point["no_fall_fraction"]["mean"] for point in report["worst"]]
    assert shares == sorted(shares) and shares[0] < 0.5
    assert {point["no_fall_fraction"]["n"] for point in report["worst"]} == {4}
    assert len(worst_case.worst_case_rows(report)) == 35
    unit = np.array([point["values"] for point in report["points"]])[:, 0] / 6.0
    assert np.histogram(unit, bins=8, range=(0, 1))[0].tolist() == [4] * 8  # evenly filled
