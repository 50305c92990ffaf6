"""What policy and critic see of the same moment."""

from __future__ import annotations

import numpy as np

from ogmp_sb3 import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observer import CRITIC_CLIP

ERROR = {"critic_observations": {"reference_error": {}}, "restarts": None, "horizon": 5}


def moved(steps: int, **changes: object) -> BatchEnv:
    env = BatchEnv(load_task("parkour", {**ERROR, **changes}), 3, seed=1, threads=1)
    env.reset()
    for _ in range(steps):
        env.step(np.zeros((3, 10)))
    return env


def test_the_critic_sees_in_typical_sizes_how_far_the_robot_is_from_the_reference_that_it_follows() -> None:
    env = moved(3)
    view = env.view()
    position = (view.base_pos_w - view.reference[:, 3:6]) / 0.1
    np.testing.assert_allclose(env.critic_observation()[:, 3:6], position, atol=1e-5)
    assert np.abs(position).max() > 0.1
    np.testing.assert_array_equal(env.critic_observation(np.array([2])), env.critic_observation()[2:])


def test_a_new_reference_is_what_is_seen_from_the_query_on() -> None:
    """It begins where the robot is, so that its position is no longer off."""
    before, at_query = moved(4).critic_observation(), moved(5).critic_observation()
    assert np.abs(before[:, 3]).min() > 0.01
    np.testing.assert_allclose(at_query[:, 3:6], 0.0, atol=1e-5)


def test_an_observation_of_the_policy_sees_the_same_reference() -> None:
    others = dict.fromkeys(("proprioception", "clock", "mode_latent", "height_scan"))
    env = moved(0, observations={**others, "reference_error": {}})
    for _ in range(6):
        seen = env.step(np.zeros((3, 10))).observation
        np.testing.assert_allclose(seen / env.observation_scale, env.critic_observation(), atol=1e-4)


def test_far_away_is_clipped_and_an_unstable_simulation_is_seen_as_nothing() -> None:
    env = moved(1)
    env.sim.qpos[0, env.sim.base_qpos] += 100.0
    env.sim.qvel[1, env.sim.base_qvel] = np.nan
    seen = env.critic_observation()
    assert seen[0, 3] == CRITIC_CLIP and seen.dtype == np.float32
    assert np.isfinite(seen).all() and seen[1, 9] == 0.0


def test_without_terms_the_critic_sees_nothing_more() -> None:
    assert moved(1, critic_observations={}).critic_observation().shape == (3, 0)
    assert moved(1, critic_observations={"reference_error": None}).critic_observation().shape == (3, 0)
