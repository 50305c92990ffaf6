"""A project of a user's own: a task, and a robot whose files lie in several directories."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from ogmp_sb3.config.catalogue import PACKAGE, ROBOTS_DIR, TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.training import Job, begin_or_go_on

BOX = """
v -{0} -{0} -{0}
v {0} -{0} -{0}
v -{0} {0} -{0}
v {0} {0} -{0}
v -{0} -{0} {0}
v {0} -{0} {0}
v -{0} {0} {0}
v {0} {0} {0}
f 1 3 4
f 1 4 2
f 5 6 8
f 5 8 7
f 1 2 6
f 1 6 5
f 3 7 8
f 3 8 4
f 1 5 7
f 1 7 3
f 2 4 8
f 2 8 6
"""
"""An OBJ file of a cube with half an edge of {0} m."""


def make_project(folder: Path) -> Path:
    """HECTOR with a cube on its trunk: the model includes a file that includes the servos, and reads a mesh.

    :return: the task file
    """
    models, meshes, task = folder / "models" / "hector", folder / "meshes", folder / "flip.yaml"
    for directory in (models / "parts", meshes):
        directory.mkdir(parents=True)
    mjcf = (ROBOTS_DIR / "hector" / "hector.xml").read_text(encoding="utf-8")
    (servos,) = re.findall(r"<actuator>.*?</actuator>", mjcf, re.S)
    mjcf = mjcf.replace(servos, '<include file="parts/all.xml"/>')
    mjcf = mjcf.replace("<compiler ", '<compiler meshdir="../../meshes" ')
    mjcf = mjcf.replace("<asset>", '<asset><mesh file="cube.obj"/>', 1)
    mjcf = mjcf.replace(
        '<freejoint name="root"/>', '<freejoint name="root"/><geom class="collision" type="mesh" mesh="cube"/>'
    )
    assert 'mesh="cube"' in mjcf
    (models / "hector.xml").write_text(mjcf, encoding="utf-8")
    (models / "parts" / "all.xml").write_text('<mujoco><include file="servos.xml"/></mujoco>')
    (models / "parts" / "servos.xml").write_text(f"<mujoco>{servos}</mujoco>")
    (meshes / "cube.obj").write_text(BOX.format(0.05))
    robot = (ROBOTS_DIR / "hector" / "robot.yaml").read_text(encoding="utf-8")
    (folder / "robot.yaml").write_text(robot.replace("mjcf: hector.xml", "mjcf: models/hector/hector.xml"))
    data = (TASKS_DIR / "dive.yaml").read_text(encoding="utf-8").replace("robot: hector", "robot: robot.yaml")
    task.write_text(data.replace("  mode_latent: {}\n", ""), encoding="utf-8")
    return task


def job(task_file: Path, run_dir: Path, total: int = 16) -> Job:
    """A training of a moment, as ``ogmp-train task=<file>`` asks for it."""
    settings = read_yaml(PACKAGE / "conf" / "train.yaml")
    settings = {field.name: settings[field.name] for field in fields(TrainConfig) if field.name in settings}
    settings |= {"total_timesteps": total, "num_envs": 1, "torch_threads": 1, "physics_threads": 1}
    settings["ppo"] |= {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "lstm_hidden_size": 8, "n_lstm_layers": 1}
    data = read_yaml(task_file)
    data["robot"] = str((task_file.parent / data["robot"]).resolve())
    config = read(TrainConfig, settings, Where("settings"))
    return Job(task=task_from_data(data, task_file), task_data=data, config=config, run_dir=run_dir)


def trained_project(folder: Path) -> Path:
    """A project with a run of one update.

    :return: the run directory
    """
    run_dir = folder / "runs" / "a"
    begin_or_go_on(job(make_project(folder), run_dir))
    return run_dir


def edit(file: Path, before: str, after: str) -> None:
    """Change a file as a user does."""
    text = file.read_text(encoding="utf-8")
    assert before in text
    file.write_text(text.replace(before, after), encoding="utf-8")
