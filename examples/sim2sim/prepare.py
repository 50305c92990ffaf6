"""Add to an exported policy what another simulator needs: the robot as URDF, and the tracks of ogmp-eval as data.

Run where ogmp_sb3 is installed, once:

    python examples/sim2sim/prepare.py run=parkour folder=exported tracks=100

It writes ``robot.urdf``, ``robot.json`` (frictions, what may touch what) and ``tracks.json`` (the tracks and starts of
``ogmp-eval episodes=<tracks> seed=<seed>``: boxes, set-points, where the robot is put down). run.py reads nothing else.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from urdf import meetings, robot_urdf

from ogmp_sb3.commands import cli
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_model import TERRAIN_FRICTION, build_model
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import FOREVER, SPAN_SIZE, append_spans, span_row
from ogmp_sb3.guidance.terrain import NOTHING, TOP, Plateau, empty_terrain, place
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.storage import checksum

PROGRAM = "prepare.py"
BEHIND_START = 2.0  # m of flat ground
LAID = 30.0  # m of every track: further than a robot gets in the time of an episode
ROOM = 1000  # boxes and set-point spans of one track


@dataclass(frozen=True, kw_only=True)
class PrepareConfig:
    """Keys of the command line."""

    run: str = cli.option("run directory, checkpoint directory, or name of a shipped policy")
    folder: str = cli.option("what ogmp-export wrote of this policy; files are added to it")
    tracks: int = cli.option("how many tracks", 100)
    seed: int = cli.option("track i is that of seed + i", 0)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)
    task: str | None = cli.option(cli.ZIP_TASK, None)

    def __post_init__(self) -> None:
        if self.tracks < 1 or self.seed < 0:
            raise ValueError(f"'tracks' must be at least 1 and 'seed' 0, found {self.tracks} and {self.seed}.")


def robot_files(robot: RobotConfig) -> dict[str, str]:
    """Contents of ``robot.urdf`` and ``robot.json``.

    :raises ValueError: for a robot that URDF has no words for
    """
    model = build_model(robot, physics_dt=0.001, terrain_boxes=1, visual=True)
    servos = read_servos(model, robot)
    torque = {
        name: float(np.max(np.abs(ends))) if np.isfinite(ends).all() else 1e6
        for name, ends in zip(robot.joints, np.stack([servos.torque_low, servos.torque_high], axis=1), strict=True)
    }
    links = meetings(model, robot.base, model.geom("terrain_0").id)
    data = {"base": robot.base, "feet": list(robot.feet), "ground_friction": TERRAIN_FRICTION[0], "links": links}
    return {
        "robot.urdf": robot_urdf(model, robot.base, torque),
        "robot.json": json.dumps(data, indent=1) + "\n",
    }


def tracks(task: TaskConfig, count: int, seed: int) -> dict[str, Any]:
    """Tracks and starts of an evaluation, as plain data.

    :param task: under its test protocol
    :raises ValueError: for a task that is not along a track
    """
    if task.horizon is None or {name for name, its in task.terminations.items() if its is not None} != {"fall"}:
        raise ValueError(f"{task.file}: this example knows tests on a track, with the one termination 'fall'.")
    env = BatchEnv(task, count, threads=1, stream="test")
    course = env.guide.course
    env.seed(seed)
    env.reset()
    sim, p, v = env.sim, env.sim.base_qpos, env.sim.base_qvel
    found = []
    for row in range(count):
        x = 0.0
        while x < LAID:  # generators of tracks draw nothing but tracks, so it does not matter when they do
            course.extend(row, x, env._rng[row], float(env.level[row]))
            x += 0.5
        start = {
            "base_pos": sim.qpos[row, p : p + 3].tolist(),
            "base_quat": sim.qpos[row, p + 3 : p + 7].tolist(),
            "base_linvel": sim.qvel[row, v : v + 3].tolist(),
            "joint_pos": sim.qpos[row, sim.joint_qpos].tolist(),
        }
        found.append({"seed": seed + row, "start": start, **laid(course.modes[row], task)})
    fall = task.terminations["fall"]
    return {
        "task": task.name,
        "steps": task.episode_steps,
        "track_length": task.track.length,
        "fall": {"min_height": fall["min_height"], "fill_gaps": fall.get("fill_gaps", True)},
        "tracks": found,
    }


def laid(calls: list[ModeCall], task: TaskConfig) -> dict[str, Any]:
    """The whole track of a sequence of modes: boxes x0 x1 y0 y1 top, spans of set-points, modes with their ends."""
    terrain, spans = empty_terrain(1, ROOM), np.zeros((ROOM, SPAN_SIZE))
    half_width, offset, count, modes = 0.5 * task.track.width, 0.0, 0, []
    place(terrain, 0, [Plateau(-BEHIND_START, 0.0, 0.0).box(0.0, half_width)], -np.inf)
    for call in calls:
        segment = call.segment()
        place(terrain, 0, [plateau.box(offset, half_width) for plateau in segment.plateaus], -np.inf)
        count = append_spans(spans, count, np.array([span_row(s, offset) for s in segment.spans]), -FOREVER)
        offset += segment.length
        modes.append([call.name, offset])
    boxes = terrain[0][terrain[0, :, TOP] > NOTHING]
    return {"boxes": boxes.tolist(), "spans": spans[: count + 1].tolist(), "modes": modes}


def _run(arguments: list[str]) -> None:
    config, _ = cli.parse(PrepareConfig, arguments, PROGRAM)
    folder = Path(config.folder)
    if not (folder / "controller.json").is_file():
        raise ValueError(f"{folder}: no exported policy; ogmp-export run={config.run} out={folder} writes one.")
    loaded = load_policy(config.run, config.trust, config.task, config.robot)
    exported = json.loads((folder / "controller.json").read_text(encoding="utf-8"))
    if exported.get("source_sha256") != checksum(loaded.files[0]):
        raise ValueError(f"{folder}: the export of another policy than '{config.run}'.")
    task = loaded.task.for_evaluation()
    files = robot_files(task.robot_config)
    files["tracks.json"] = json.dumps(tracks(task, config.tracks, config.seed)) + "\n"
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    cli.console().print(f"{folder}: {', '.join(files)}")


HELP = cli.usage(
    PROGRAM,
    "add the robot as URDF and tracks as JSON to an exported policy.",
    ["python examples/sim2sim/prepare.py run=parkour folder=exported tracks=100"],
    PrepareConfig,
)

if __name__ == "__main__":
    cli.run(PROGRAM, HELP, _run)
