"""Recorded episodes as plain arrays, against MuJoCo's own kinematics of the robot's file."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.players import still_player
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering import replay
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.replay import Arrays, RecordedEpisode, replay_data
from ogmp_sb3.rendering.shapes import box, sphere

STEPS = 25


class Recording:
    """What a page reads."""

    def __init__(self, task: TaskConfig, frames: list[Frame]) -> None:
        self.data, self.bytes = replay_data(task, [RecordedEpisode(name="a", detail="b", frames=frames)])
        self.episode: dict[str, Any] = self.data["episodes"][0]

    def array(self, number: int) -> np.ndarray:
        entry = self.data["arrays"][number]
        count = int(np.prod(entry["shape"]))
        return np.frombuffer(self.bytes, f"<{np.dtype(entry['type']).str[1:]}", count, entry["start"]).reshape(
            entry["shape"]
        )


def moved(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of a frame in the world; a pose is a position and a quaternion wxyz."""
    return Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(points) + pose[:3]


@pytest.fixture(scope="module", params=["parkour", "dive"])
def task(request: pytest.FixtureRequest) -> TaskConfig:
    return load_task(request.param)


@pytest.fixture(scope="module")
def frames(task: TaskConfig) -> list[Frame]:
    player = still_player(task, seed=1)
    frames = [player.frame, *(player.step() for _ in range(STEPS))]
    return frames[: 1 + next((i for i, frame in enumerate(frames) if frame.ended), STEPS)]


@pytest.fixture(scope="module")
def recording(task: TaskConfig, frames: list[Frame]) -> Recording:
    return Recording(task, frames)


def true_places(task: TaskConfig, qpos: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot's file, by itself, in a position."""
    model = mujoco.MjModel.from_xml_path(str(task.robot_config.mjcf_path))
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return model, data


def check_geoms(recording: Recording, bodies: np.ndarray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Every geom that is drawn lies where MuJoCo puts it, with the size that MuJoCo gives it."""
    seen, geoms = np.flatnonzero(model.geom_group == 1), recording.data["robot"]["geoms"]
    assert len(geoms) == len(seen)
    for i, geom in zip(seen, geoms, strict=True):
        vertices = recording.array(recording.data["robot"]["meshes"][geom["mesh"]]["vertices"])
        found = moved(bodies[geom["body"]], moved(np.array(geom["pose"]), vertices))
        inside = (found - data.geom_xpos[i]) @ data.geom_xmat[i].reshape(3, 3)
        centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
        np.testing.assert_allclose(inside.min(axis=0), centre - half, atol=1e-4)
        np.testing.assert_allclose(inside.max(axis=0), centre + half, atol=1e-4)


def test_every_geom_is_where_mujoco_puts_it_in_every_step(
    task: TaskConfig, frames: list[Frame], recording: Recording
) -> None:
    poses = recording.array(recording.episode["robot"])
    assert len(poses) == len(frames) == recording.episode["steps"] > 10
    for frame, bodies in zip(frames, poses, strict=True):
        check_geoms(recording, bodies, *true_places(task, frame.robot))


def test_the_ghost_is_the_nominal_pose_at_the_reference(
    task: TaskConfig, frames: list[Frame], recording: Recording
) -> None:
    around, bases = recording.array(recording.data["ghost"]), recording.array(recording.episode["ghost"])
    for frame, base in zip(frames, bases, strict=True):
        np.testing.assert_allclose(base[:3], frame.reference, atol=1e-5)
        turn = Rotation.from_quat(base[[4, 5, 6, 3]])
        turned = (turn * Rotation.from_quat(around[:, [4, 5, 6, 3]])).as_quat()[:, [3, 0, 1, 2]]
        bodies = np.concatenate([moved(base, around[:, :3]), turned], axis=1)
        check_geoms(recording, bodies, *true_places(task, frame.ghost))


def test_the_plan_of_every_step_is_the_oracle_s(frames: list[Frame], recording: Recording) -> None:
    plans = [recording.array(plan) for plan in recording.episode["plans"]]
    for frame, number in zip(frames, recording.array(recording.episode["plan"]), strict=True):
        np.testing.assert_allclose(plans[number], frame.trail, atol=1e-5)
    assert all(not np.array_equal(a, b) for a, b in itertools.pairwise(plans))


def test_modes_are_named_from_where_they_begin(task: TaskConfig, frames: list[Frame]) -> None:
    names = ["pace v 1.00", "pace v 1.00", "jump h 0.30", "pace v 1.20", "pace v 1.20"]
    episode = Recording(task, [replace(frame, mode=name) for frame, name in zip(frames, names, strict=False)]).episode
    assert [(mode["start"], mode["name"], mode["text"]) for mode in episode["modes"]] == [
        (0, "pace", "pace v 1.00"),
        (2, "jump", "jump h 0.30"),
        (3, "pace", "pace v 1.20"),
    ]


def test_charts_show_what_the_frames_say(task: TaskConfig, frames: list[Frame], recording: Recording) -> None:
    charts = recording.data["charts"]
    values = [
        dict(zip((line["name"] for line in chart["lines"]), recording.array(number), strict=True))
        for chart, number in zip(charts, recording.episode["charts"], strict=True)
    ]
    along_track = task.name == "parkour"
    np.testing.assert_allclose(values[0]["robot"], [f.robot[2] for f in frames], rtol=1e-6)
    np.testing.assert_allclose(values[0]["reference"], [f.reference[2] for f in frames], rtol=1e-6)
    np.testing.assert_allclose(values[1]["robot"], [f.velocity[0 if along_track else 2] for f in frames], rtol=1e-5)
    if along_track:
        np.testing.assert_allclose(values[1]["asked for"], [f.commanded_speed for f in frames], rtol=1e-6)
    np.testing.assert_allclose(values[2]["robot"], [f.deviation / task.rho for f in frames], rtol=1e-6)
    assert set(values[2]["bound"]) == {1.0}
    assert charts[1]["title"].startswith("Speed along" if along_track else "Speed upwards")


def test_there_is_no_ground_in_a_chart_over_a_gap(task: TaskConfig, frames: list[Frame]) -> None:
    over_gap = Recording(task, [replace(frames[0], ground=0.2), replace(frames[1], ground=-50.0)])
    np.testing.assert_allclose(over_gap.array(over_gap.episode["charts"][0])[0], [0.2, np.nan])


def test_without_a_bound_the_deviation_is_plotted_as_it_is(task: TaskConfig, frames: list[Frame]) -> None:
    recording = Recording(replace(task, rho=None), frames)
    assert recording.data["bound"] is None
    np.testing.assert_allclose(recording.array(recording.episode["charts"][2])[0], [f.deviation for f in frames])


def test_all_ground_of_an_episode_is_there_from_the_start(task: TaskConfig, frames: list[Frame]) -> None:
    boxes = np.array([(0.0, 1.0, -1.0, 1.0, 0.0), (1.0, 1.4, -1.0, 1.0, 0.3)])
    recording = Recording(task, [replace(frames[0], terrain=boxes[:1]), replace(frames[1], terrain=boxes[1:])])
    tops = [box["centre"][2] + box["half"][2] for box in recording.episode["ground"]]
    ends = [box["centre"][0] + box["half"][0] for box in recording.episode["ground"]]
    np.testing.assert_allclose((tops, ends), [(0.0, 0.3), (1.0, 1.4)])


def test_where_only_the_oracle_plays_there_is_no_robot_and_none_in_the_charts(task: TaskConfig) -> None:
    player = Player(task, None)
    recording = Recording(task, [player.frame, *(player.step() for _ in range(3))])
    assert recording.episode["robot"] is None
    styles = [[line["style"] for line in chart["lines"]] for chart in recording.data["charts"]]
    assert styles == [["ground", "reference"], ["reference"]]


@pytest.mark.parametrize(("ended", "fell"), [("fall", True), ("unstable", True), ("time_limit", False), ("", False)])
def test_only_what_a_rule_ended_before_its_time_has_fallen(
    task: TaskConfig, frames: list[Frame], ended: str, fell: bool
) -> None:
    episode = Recording(task, [frames[0], replace(frames[1], ended=ended)]).episode
    assert (episode["fell"], episode["ended"]) == (fell, ended.replace("_", " "))


def test_a_robot_of_many_faces_is_drawn_with_fewer_and_keeps_its_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "MOST_FACES", 600)
    ball, small = sphere().scaled(0.05), box()
    coarse, same = replay.coarse_enough([ball, small])
    assert same is small
    assert len(ball.faces) > 600 - len(small.faces) >= len(coarse.faces) > 200
    radius = np.linalg.norm(coarse.vertices, axis=1)
    assert 0.045 < radius.min() and radius.max() < 0.0501
    edges = np.concatenate([coarse.faces[:, [0, 1]], coarse.faces[:, [1, 2]], coarse.faces[:, [2, 0]]]).tolist()
    assert {(a, b) for a, b in edges} == {(b, a) for a, b in edges}  # still closed


def test_arrays_begin_where_a_browser_can_read_them() -> None:
    arrays = Arrays()
    arrays.add(np.arange(3), "uint16")
    arrays.add(np.array([[1.5, -2.5]]))
    assert [entry["start"] for entry in arrays.table] == [0, 8]
    assert np.frombuffer(bytes(arrays.data), "<f4", 2, 8).tolist() == [1.5, -2.5]
    assert np.frombuffer(bytes(arrays.data), "<u2", 3).tolist() == [0, 1, 2]
