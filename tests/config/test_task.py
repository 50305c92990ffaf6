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


def test_policy_and_critic_observe_the_same_latent() -> None:
    both = {"critic_observations": {"mode_latent": {}, "reference_error": {}}}
    task = load_task("parkour", {**both, "observations": {"mode_latent": None, "clock": None}})
    assert task.uses_latent and not task.latent_of_both_sides
    assert list(task.observed) == ["mode_latent", "reference_error", "proprioception", "height_scan"]
    with pytest.raises(ValueError, match="'mode_latent' must be the same in 'observations' and 'critic_observations'"):
        load_task("parkour", {**both, "observations.mode_latent.both_sides": True})
    with pytest.raises(KeyError, match="Did you mean 'reference_error'"):
        load_task("parkour", {"critic_observations": {"reference_eror": {}}})


def test_the_test_protocol_has_no_bound_no_floor_and_no_curriculum() -> None:
    unusual = {"evaluation.terminations.off_track": {}, "critic_observations": {"reference_error": {}}}
    task = load_task("parkour", unusual).for_evaluation()
    assert not task.critic_observations
    assert (task.rho, task.min_step_reward, task.curriculum) == (None, None, None)
    assert (task.episode_steps, task.track.length) == (400, 10.0)
    assert list(task.terminations) == ["fall", "off_track"]


def test_the_test_has_its_own_physics_step_or_that_of_the_training() -> None:
    task = load_task("parkour", {"physics_dt": 0.006, "evaluation.physics_dt": 0.001})
    assert (task.physics_dt, task.for_evaluation().physics_dt, task.for_evaluation().substeps) == (0.006, 0.001, 30)
    task = load_task("parkour", {"physics_dt": 0.006, "evaluation.physics_dt": None})
    assert task.for_evaluation().physics_dt == 0.006


def test_both_physics_steps_must_divide_the_control_step() -> None:
    with pytest.raises(ValueError, match=r"control_dt / evaluation.physics_dt must be a whole number"):
        load_task("parkour", {"evaluation.physics_dt": 0.004})
    with pytest.raises(ValueError, match=r"'evaluation.physics_dt' must be above 0, found -0.002"):
        load_task("parkour", {"evaluation.physics_dt": -0.002})
