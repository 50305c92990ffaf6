"""Playing step by step, without viewer and without a trained policy."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from helpers.players import Still, flat, still_player
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance.terrain import X1, height_at
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.player import Player, endless
from ogmp_sb3.sb3.policy import LstmPolicy


def until_end(player: Player) -> list[Frame]:
    frames = [player.step()]
    while not frames[-1].ended:
        frames.append(player.step())
        assert len(frames) < 1000
    return frames


def test_a_policy_s_frames_are_those_of_the_environment() -> None:
    task = flat()
    player, env = still_player(task, seed=3), BatchEnv(endless(task), 1, 3, stream="test")
    env.reset()
    for step in range(1, 11):
        frame, result = player.step(), env.step(np.zeros((1, 10)))
        np.testing.assert_array_equal(frame.robot, env.sim.qpos[0])
        np.testing.assert_array_equal(frame.reference, result.view.reference[0, 3:6])
        np.testing.assert_array_equal(frame.ghost[3:7], result.view.reference_quat[0])
        assert frame.deviation == result.view.deviation[0]
        assert frame.reward == result.reward[0]
        assert frame.time == pytest.approx(0.03 * step)


def test_a_seed_shows_the_track_and_the_start_of_the_test_episode_of_that_seed() -> None:
    task = load_task("parkour")
    player, env = still_player(task, seed=3), BatchEnv(task.for_evaluation(), 1, 3, stream="test")
    env.reset()
    np.testing.assert_array_equal(player.frame.robot, env.sim.qpos[0])
    assert repr(player.env.modes[0]) == repr(env.modes[0])


def test_an_oracle_s_robot_keeps_the_nominal_pose() -> None:
    player = Player(load_task("parkour", {"evaluation.initial.joint_pos": [0.1, 0.2]}), None)
    sim = player.env.sim
    np.testing.assert_array_equal(sim.qpos[0, sim.joint_qpos], player.task.robot_config.nominal_joints)


def test_an_episode_that_ended_begins_anew_with_a_fresh_policy_state() -> None:
    player = still_player(load_task("dive"))
    frames = until_end(player)
    assert frames[-1].ended == "fall"
    again = player.step()
    assert (again.time, again.ended) == (0.0, "")
    player.step()
    starts = cast(Still, player.policy).starts
    assert [i for i, start in enumerate(starts) if start] == [0, len(frames)]


def test_a_policy_of_other_observations_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the task shows \d+ numbers, but the policy observes 3"):
        Player(flat(), cast(LstmPolicy, Still(3)))


def test_neither_bound_nor_time_ends_an_episode_on_a_track() -> None:
    task = endless(flat(rho=0.01, episode_steps=5))
    assert task.rho is None and task.min_step_reward is None and task.track.length is None
    assert task.episode_steps > 10**6
    assert endless(load_task("dive")).episode_steps == load_task("dive").evaluation.episode_steps


def test_the_same_seed_gives_the_same_episode() -> None:
    player = still_player(load_task("parkour"), seed=1)
    first = [player.step().robot for _ in range(10)]
    player.reset(seed=1)
    np.testing.assert_array_equal([player.step().robot for _ in range(10)], first)


def test_the_oracle_alone_follows_its_own_references_without_a_robot() -> None:
    player = Player(load_task("parkour"), None)
    plan = player.frame.trail
    for knot in range(1, 30):
        frame = player.step()
        np.testing.assert_allclose(frame.ghost[:3], plan[knot], atol=1e-12)
        assert frame.deviation == pytest.approx(0.0, abs=1e-9)
        assert not len(frame.robot)
    player.step()
    np.testing.assert_allclose(player.frame.ghost[:3], plan[30], atol=1e-12)
    np.testing.assert_allclose(player.frame.trail[0], plan[30], atol=1e-12)


@pytest.mark.parametrize("name", ["parkour", "stairs"])
def test_the_oracle_alone_crosses_the_whole_track_over_its_terrain(name: str) -> None:
    player = Player(load_task(name), None)
    for _ in range(400):
        frame = player.step()
        assert not frame.ended
        assert height_at(frame.terrain[None], frame.base[None, None, :2]) > -1.0
        assert (frame.terrain[:, X1] > frame.base[0] - 7.0).all()
    assert frame.base[0] > 6.0


def test_the_oracle_alone_needs_no_encoder() -> None:
    task = load_task("parkour", {"encoder": None})
    assert task.uses_latent
    assert Player(task, None).step().time > 0


def test_a_command_comes_next() -> None:
    player = Player(flat(), None)
    player.command("pace", v=1.1, length=3.0)
    modes = {player.step().mode for _ in range(120)}
    assert "pace v 1.10, length 3.00" in modes


def test_a_command_of_a_timed_task_begins_anew_with_it() -> None:
    player = Player(load_task("dive"), None)
    assert list(player.commands) == ["flip"]
    player.step()
    player.command("flip", r="left", h=1.2)
    assert player.frame.time == 0.0
    assert player.frame.mode == "flip left, h 1.20"
    while player.step().mode != "settle":
        pass
    assert player.frame.base[1] > 0.3


@pytest.mark.parametrize("overrides", [{}, {"modes.flip.h": 2.0}])
def test_a_flip_from_as_high_as_the_viewer_s_slider_goes_can_be_commanded(overrides: dict[str, float]) -> None:
    player = Player(load_task("dive", overrides), None)
    for direction in ("front", "left"):
        player.command("flip", r=direction, h=player.commands["flip"]["h"].beyond()[1])
        while player.step().mode != "settle":
            pass


def test_a_timed_mode_that_lasts_too_long_is_refused_in_a_sentence() -> None:
    player = Player(load_task("dive"), None)
    with pytest.raises(ValueError, match=r"flip \(r front, h 20\.0\) lasts 2\.\d s; there is room for 2\.\d s"):
        player.command("flip", r="front", h=20.0)
    assert player.step().time > 0


def test_a_seed_forgets_what_was_commanded() -> None:
    player, other = Player(flat(), None), Player(flat(), None)
    player.command("pace", v=1.1, length=3.0)
    player.reset(5)
    other.reset(5)
    assert [call.parameters for call in player.env.modes[0]] == [call.parameters for call in other.env.modes[0]]


def test_unknown_commands_are_refused() -> None:
    with pytest.raises(KeyError, match="no mode 'hop'"):
        Player(flat(), None).command("hop")


def test_a_push_changes_the_velocity_at_once() -> None:
    pushed, left_alone = still_player(flat()), still_player(flat())
    pushed.push((0.0, 0.5))
    assert pushed.step().base[1] - left_alone.step().base[1] == pytest.approx(0.5 * 0.03, rel=0.3)


def test_the_terms_of_the_reward_come_with_a_frame_and_add_up() -> None:
    frame = still_player(flat()).step()
    assert set(frame.reward_terms) >= {"position_tracking", "orientation_tracking"}
    assert sum(frame.reward_terms.values()) == pytest.approx(frame.reward)


def test_contacts_are_those_of_the_robot_and_an_oracle_alone_has_none() -> None:
    player = still_player(flat())
    while not len(player.contacts()[0]):
        player.step()
    points, forces = player.contacts()
    assert points.shape == forces.shape == (len(points), 3) and forces[:, 2].sum() > 0.0
    assert Player(load_task("parkour"), None).contacts()[0].shape == (0, 3)
