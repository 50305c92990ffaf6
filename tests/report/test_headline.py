"""What a report on one run begins with."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report import headline as module
from ogmp_sb3.report.headline import STRIP, VIDEO, film_of, headline
from ogmp_sb3.report.page import KeyNumbers, Note, Picture

NO_OPENGL = ValueError("no OpenGL found: install one.")


def subject(task: str) -> Any:
    return SimpleNamespace(task=load_task(task))


def evaluation(objective: list[float]) -> Evaluation:
    metrics = {"true_objective": Estimate(0.975, 0.1, 4, 0.5, 1.0), "return": Estimate(312.34, 5.0, 4, 300.0, 320.0)}
    return Evaluation(metrics, {}, 0.0, {"time_limit": 3, "fall": 1}, values={"true_objective": objective})


def numbers(task: str, objective: list[float]) -> KeyNumbers:
    (part,) = headline(subject(task), evaluation(objective), []).parts
    assert isinstance(part, KeyNumbers)
    return part


def test_what_is_yes_or_no_is_a_share_in_per_cent() -> None:
    first, second, third = numbers("dive", [True, True, True, False]).numbers
    thin = module.THIN
    assert (first.label, first.value) == ("flip and land", f"97.5{thin}%")
    assert first.about.startswith(f"95 % interval 50.0{thin}…{thin}100.0, n = 4. Dive: 1 if the base turned once")
    assert (second.label, second.value) == ("without a fall", f"75.0{thin}%")
    assert (third.label, third.value) == ("return", "312.3")
    assert third.about.endswith("n = 4. Sum of the training reward, of 150 at most.")


def test_a_distance_is_a_distance() -> None:
    first = numbers("parkour", [0.9, 1.0, 1.0, 1.0]).numbers[0]
    assert (first.label, first.value) == ("track displacement", "0.97") or first.value == "0.98"
    assert "up to its end, m." in first.about


def test_a_number_without_an_interval_says_so() -> None:
    alone = Estimate(10.0, None, 1, None, None)
    found = Evaluation({"true_objective": alone, "return": alone}, {}, 0.0, {"fall": 1}, values={})
    (part,) = headline(subject("parkour"), found, []).parts
    assert isinstance(part, KeyNumbers)
    assert part.numbers[0].about.startswith("No interval, n = 1. ")


def test_the_numbers_stand_below_the_first_picture() -> None:
    film: list[Any] = [Picture("film", "", "data:", []), Note("another")]
    kinds = [part.kind for part in headline(subject("parkour"), evaluation([1.0]), film).parts]
    assert kinds == ["picture", "numbers", "note"]


def test_where_nothing_can_be_drawn_a_strip_is_a_sentence_and_a_video_a_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> str:
        raise NO_OPENGL

    monkeypatch.setattr(module, "gl_library", missing)
    (note,) = film_of(subject("parkour"), 0, [STRIP], tmp_path)
    assert note == Note("No pictures of the robot: no OpenGL found: install one.")
    with pytest.raises(ValueError, match="no OpenGL found"):
        film_of(subject("parkour"), 0, [STRIP, VIDEO], tmp_path)
    assert film_of(subject("parkour"), 0, [], tmp_path) == []
