"""What the dataclasses of task files hold, and what they refuse."""

import dataclasses

import pytest

from helpers.mistakes import SHIPPED
from ogmp_sb3 import load_task
from ogmp_sb3.config.robot import STATE_NAMES


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_task_says_what_its_file_says(name: str) -> None:
    task, data = load_task(name), SHIPPED[name]
    assert (task.name, task.file) == (name, f"tasks/{name}.yaml")
    assert task.rho == data["rho"]
    assert task.horizon == data["horizon"]
    assert list(task.observations) == list(data["observations"])
    assert task.oracle_params["preview"] == task.oracle_params["lqr"] == data["oracle_params"]["lqr"]
    assert task.substeps * task.physics_dt == pytest.approx(task.control_dt)
    assert task.evaluation.metrics == tuple(data["evaluation"]["metrics"])


def test_a_task_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_task("parkour").rho = 1.0  # type: ignore[misc]


def test_bound_weights_follow_the_state_names() -> None:
    weights = load_task("parkour", {"bound": {"x": 2.0, "vz": 3.0}}).bound_weights
    assert dict(zip(STATE_NAMES, weights, strict=True)) == dict.fromkeys(STATE_NAMES, 0.0) | {"x": 2.0, "vz": 3.0}


def test_the_test_protocol_has_no_bound_no_floor_and_no_curriculum() -> None:
    task = load_task("parkour", {"evaluation.terminations.off_track": {}}).for_evaluation()
    assert (task.rho, task.min_step_reward, task.curriculum) == (None, None, None)
    assert (task.episode_steps, task.track.length) == (400, 10.0)
    assert list(task.terminations) == ["fall", "off_track"]
