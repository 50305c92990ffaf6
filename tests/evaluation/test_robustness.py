"""Sweeps of disturbances: what is played, and that the size of a disturbance tells."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.learners import make_policy
from helpers.programs import program
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation import robustness
from ogmp_sb3.evaluation.episodes import play_episodes


class Standing:
    """A policy that holds the nominal pose."""

    def predict(self, observation: np.ndarray, *_: object, **__: object) -> tuple[np.ndarray, None]:
        return np.zeros((len(observation), 10)), None


NAMES = ["mass", "friction", "gains", "motor_strength", "action_delay", "sensor_noise", "push", "slope", "rough_ground"]


def disturbance(name: str, **declared: object) -> robustness.Sweep:
    task = load_task("parkour", {"randomisation": declared})
    return next(found for found in robustness.task_disturbances(task) if found.name == name)


def test_the_usual_disturbances_are_played_and_those_that_a_task_declares() -> None:
    found = robustness.task_disturbances(load_task("parkour", {"randomisation": {"wind": {"force": 10}}}))
    assert [each.name for each in found] == [*NAMES, "wind"]


def test_there_is_no_noise_where_nothing_has_it() -> None:
    found = robustness.task_disturbances(load_task("parkour", {"observations.proprioception": None}))
    assert [each.name for each in found] == [name for name in NAMES if name != "sensor_noise"]


@pytest.mark.parametrize(
    ("name", "declared", "values"),
    [
        ("mass", {"scale": [0.8, 1.1]}, [0.6, 0.7, 0.8, 0.9, 1.0, 1.05, 1.1, 1.15, 1.2]),
        ("friction", {"coefficient": [0.5, 1.2]}, [0.05, 0.25, 0.5, 0.75, 1.0, 1.1, 1.2, 1.3, 1.4]),
        ("friction", {"coefficient": [0.4, 0.6]}, [0.05, 0.1, 0.4, 0.7, 1.0]),
        ("gains", {"scale": [1.0, 1.4]}, [1.0, 1.2, 1.4, 1.6, 1.8]),
        ("action_delay", {"delay": [0.01, 0.02]}, [0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.03]),
        ("action_delay", {"delay": 0.011}, [0.0, 0.002, 0.004, 0.006, 0.008, 0.012, 0.016]),  # rounded to 2 ms
        ("action_delay", {"delay": [0, 0.4]}, [0.0, 0.08, 0.16, 0.24, 0.32, 0.4, 0.5]),
        ("sensor_noise", {"scale": 0.1}, [0.0, 0.05, 0.1, 0.15, 0.2]),
        ("push", {"every": 2, "speed": [0.1, 0.4]}, [0.0, 0.2, 0.4, 0.6, 0.8]),
        ("slope", {"pitch": [-0.1, 0.05]}, [-0.2, -0.15, -0.1, -0.05, 0.0, 0.025, 0.05, 0.075, 0.1]),
    ],
)
def test_sizes_go_from_none_to_twice_the_range_of_the_task(
    name: str, declared: dict[str, object], values: list[float]
) -> None:
    found = disturbance(name, **{name: declared})
    assert found.declared
    np.testing.assert_allclose(list(found.points), values, atol=1e-9)


def test_all_parameters_of_a_disturbance_grow_together() -> None:
    found = disturbance("action_delay", action_delay={"delay": [0.0, 0.02], "jitter": 0.004})
    assert found.points[0.02] == {"delay": 0.02, "jitter": 0.004}
    assert found.points[0.03] == {"delay": 0.03, "jitter": 0.006}
    assert found.points[0.0] == {"delay": 0.0, "jitter": 0.0}


def test_what_the_task_leaves_out_gets_a_default_range() -> None:
    found = disturbance("gains", mass={"scale": 1.2})
    assert not found.declared
    assert (min(found.points), max(found.points)) == (0.8, 1.2)
    delay = disturbance("action_delay", mass={"scale": 1.2})
    assert (delay.label, delay.none) == ("delay of actions (s)", {"delay": 0.0})
    assert list(delay.points) == [0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.03]


@pytest.mark.parametrize(
    ("written", "friction"),
    [
        ('friction="1.3"', 1.3),
        ('friction="0.8"', 1.0),
        ('friction="0.8" priority="1"', 0.8),
        ('friction="1.3" priority="-1"', 1.0),
    ],
)
def test_undisturbed_is_the_friction_between_feet_and_ground(written: str, friction: float, tmp_path: Path) -> None:
    task = load_task("parkour")
    mjcf = task.robot_config.mjcf_path.read_text(encoding="utf-8")
    (tmp_path / "other.xml").write_text(mjcf.replace('friction="1.0"', written), encoding="utf-8")
    other = replace(task, robot_config=replace(task.robot_config, mjcf=str(tmp_path / "other.xml")))
    none = {found.name: found.none for found in robustness.task_disturbances(other)}
    assert none["friction"] == {"coefficient": friction}


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("robustness")
    make_policy(folder / "policy", "dive", 1)
    arguments = ["randomisation.push.speed=3.0", "evaluation.episode_steps=15"]
    done = program("eval", "run=policy", "robustness=true", "episodes=4", "out=eval", *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "eval"


def test_eval_writes_figure_table_and_report(evaluation: Path) -> None:
    report = json.loads((evaluation / "robustness.json").read_text())["robustness"]
    assert [result["disturbance"] for result in report] == NAMES
    assert [result["declared"] for result in report] == [None] * 6 + [[3.0, 3.0]] + [None] * 2
    with (evaluation / "robustness.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    points = [(result["disturbance"], point) for result in report for point in result["points"]]
    assert len(rows) == len(points)
    for row, (name, point) in zip(rows, points, strict=True):
        found = point["no_fall_fraction"]
        assert (row["disturbance"], float(row["value"]), int(row["episodes"])) == (name, point["value"], 4)
        assert float(row["no_fall_fraction"]) == found["mean"]
        assert found["ci95"][0] <= found["mean"] <= found["ci95"][1]
    assert (evaluation / "robustness.png").stat().st_size > 20_000


@pytest.mark.parametrize("name", NAMES)
def test_a_disturbance_of_no_size_is_none(name: str) -> None:
    """What is played once counts for all of them."""
    task = load_task("parkour", {"evaluation.episode_steps": 20}).for_evaluation()
    each = disturbance(name, **({"push": {"every": 0.1, "speed": 0.5}} if name == "push" else {}))
    (plain,) = play_episodes(Standing(), task, 1, 0)
    none, *_, some = (
        play_episodes(Standing(), replace(task, randomisation={name: robustness.fixed(parameters)}), 1, 0)[0]
        for parameters in (each.none, *each.points.values())
    )
    np.testing.assert_allclose(none.base_pos_w, plain.base_pos_w, rtol=0, atol=1e-9)
    if name not in ("sensor_noise", "action_delay"):  # which a policy that neither looks nor moves cannot tell
        assert np.abs(some.base_pos_w[: len(plain.base_pos_w)] - plain.base_pos_w[: len(some.base_pos_w)]).max() > 1e-6


def test_robustness_and_grid_do_not_go_together(tmp_path: Path) -> None:
    done = program("eval", "run=x", "robustness=true", "grid=jump.w,jump.h", cwd=tmp_path)
    assert done.returncode == 2
    assert "'grid' and 'robustness' are different evaluations: give one of them." in done.stderr


def test_a_disturbance_of_the_test_is_refused_where_all_are_played(tmp_path: Path) -> None:
    done = program(
        "eval", "run=dive", "robustness=true", "evaluation.randomisation.friction.coefficient=0.5", cwd=tmp_path
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "'robustness' disturbs one thing at a time; its ranges are 'randomisation'" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_policy_that_stands_falls_under_pushes_that_are_hard_enough() -> None:
    task = load_task("parkour", {"evaluation.episode_steps": 12, "modes.jump": None, "modes.leap": None})
    pushes = [disturbance("push", push={"every": 0.1, "speed": 4.0})]
    (result,) = robustness.play_disturbed(pushes, Standing(), task.for_evaluation(), 20, 0, None, lambda _: None)
    fractions = [point["no_fall_fraction"]["mean"] for point in result["points"]]
    assert fractions[0] == 1.0
    assert fractions[-1] < 0.5
