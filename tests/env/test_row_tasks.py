"""Rows of one batch that draw by tasks of their own: each is what an environment of its task alone would be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from helpers.batches import SEED, actions, assert_same, play
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.row_tasks import common_task

OFF = {"curriculum": None, "restarts": None, "episode_steps": 30}
PARKOUR = [
    {"sampling.weights": {"pace": 0.0, "jump": 1.0, "leap": 0.0}, "modes.jump.w": [0.05, 0.1], "track.boxes": 40},
    {
        "modes.pace.v": 4.0,
        "randomisation": {"mass": {"scale": [0.5, 1.5]}, "push": {"every": 0.1, "speed": [0.5, 2.0]}},
    },
    {"randomisation": {"action_delay": {"delay": [0.0, 0.07]}, "sensor_noise": {"scale": 0.1}}},
    {
        "randomisation": {
            "friction": {"coefficient": 0.2},
            "gains": {"scale": [0.5, 1.5]},
            "push": {"every": 0.25, "speed": 1.0},
        }
    },
    {"modes.leap.d": 0.7, "randomisation": {"action_delay": {"delay": 0.011}}},
    {},
]
DIVE = [{"modes.flip.h": 1.0}, {"modes.flip.h": [1.2, 1.4], "modes.flip.r": "back"}, {"randomisation.mass.scale": 1.4}]


def tasks(name: str, differences: list[dict[str, Any]]) -> list[TaskConfig]:
    return [load_task(name, {**OFF, **each}) for each in differences]


@pytest.mark.parametrize(("name", "differences"), [("parkour", PARKOUR), ("dive", DIVE)])
def test_every_row_is_bit_for_bit_an_environment_of_its_task_alone(
    name: str, differences: list[dict[str, Any]]
) -> None:
    row_tasks = tasks(name, differences)
    commands = actions(70, len(row_tasks))  # some episodes end, and begin anew
    together = play(BatchEnv(row_tasks[0], len(row_tasks), SEED, threads=1, row_tasks=row_tasks), commands)
    for row, task in enumerate(row_tasks):
        rows = slice(row, row + 1)
        assert_same(play(BatchEnv(task, 1, SEED + row, threads=1), commands[:, rows]), together, rows)
    assert any(step["terminated"].any() or step["truncated"].any() for step in together[1:])


def test_a_row_is_commanded_within_the_ranges_of_its_task() -> None:
    row_tasks = tasks("parkour", [{"modes.jump.h": 0.11}, {"modes.jump.h": 0.22}])
    env = BatchEnv(row_tasks[0], 2, SEED, threads=1, row_tasks=row_tasks)
    for row in range(2):
        env.command(row, "jump")
    env.reset()
    assert [calls[0].parameters["h"] for calls in env.modes] == [0.11, 0.22]


def test_what_tasks_have_in_common_has_room_for_the_terrain_of_each() -> None:
    small, large, other = tasks("parkour", [{}, {"track.boxes": 50}, {"modes.pace": None}])
    assert common_task([small, large, other]) == replace(small, track=large.track)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [("oracle", "lqr", "oracle"), ("track.width", 3.0, "track"), ("evaluation.initial", None, "evaluation")],
)
def test_tasks_that_differ_in_anything_else_are_not_played_together(key: str, value: Any, named: str) -> None:
    row_tasks = tasks("parkour", [{}, {key: value}])
    sentence = f"may differ in modes, sampling, randomisation and track.boxes alone; found different {named}."
    with pytest.raises(ValueError, match=sentence):
        BatchEnv(row_tasks[0], 2, SEED, threads=1, row_tasks=row_tasks)


def test_every_row_needs_a_task() -> None:
    task = load_task("parkour", OFF)
    with pytest.raises(ValueError, match="'row_tasks' must be 3 tasks, one for each row, found 2"):
        BatchEnv(task, 3, row_tasks=[task, task])
