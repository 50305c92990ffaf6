"""``ogmp-task``: a task that was made for one robot, for another one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ogmp_sb3.commands import cli
from ogmp_sb3.config.catalogue import find, is_path, shipped
from ogmp_sb3.config.load import load_robot, load_task
from ogmp_sb3.config.task_files import extended_files, read_task
from ogmp_sb3.porting.scale import Similar, scaled
from ogmp_sb3.porting.task_yaml import task_yaml
from ogmp_sb3.runs.atomic import replacing

PROGRAM = "ogmp-task"


@dataclass(frozen=True, kw_only=True)
class TaskCommandConfig:
    """Keys of the command line."""

    new: str = cli.option("name of the task; written to tasks/<new>.yaml, where it is found by name")
    robot: str = cli.option("its robot: a name, or the path of a robot.yaml")
    from_: str = cli.option("the task that it is like, a name or the path of a YAML file", "parkour")
    replace: bool = cli.option("true: write over a file that is there", False)

    def __post_init__(self) -> None:
        cli.check_name("new", self.new)


HELP = cli.usage(
    PROGRAM,
    "write a task for another robot: lengths, times, speeds and weights scaled by its legs and its mass.",
    [
        "ogmp-task new=g1_parkour robot=g1",
        "ogmp-task new=g1_parkour robot=g1 from=parkour replace=true",
        "ogmp-task new=my_dive robot=robots/mine/robot.yaml from=dive",
    ],
    TaskCommandConfig,
)


def _run(arguments: list[str]) -> None:
    config, _ = cli.parse(TaskCommandConfig, arguments, PROGRAM)
    if config.new in shipped("task"):
        raise ValueError(f"'{config.new}' ships with ogmp_sb3: give another name.")
    file = Path("tasks") / f"{config.new}.yaml"
    if file.exists() and not config.replace:
        raise ValueError(f"{file} is there already: give another name, or replace=true.")
    path = find("task", config.from_)
    if file.absolute() in [each.absolute() for each in (path, *extended_files(path))]:
        raise ValueError(f"'{config.from_}' is {file} itself, or extends it: give another name.")
    task, data, robot = load_task(config.from_), read_task(path), load_robot(config.robot)
    grow = Similar.of(robot, task.robot_config)
    encoder = config.new if task.encoder else None
    base, its_robot = (_from(file.parent, name) for name in (config.from_, config.robot))
    text = task_yaml(base, its_robot, encoder, scaled(data, task, robot), grow)
    cli.check_out(file.parent)
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as written:
        written.write_text(text, encoding="utf-8")
        load_task(str(written.absolute()))
    console = cli.console()
    console.print(text, end="")
    steps = [f"ogmp-check {config.new} out=check", f"ogmp-train task={config.new}"]
    if encoder:
        steps.insert(0, f"ogmp-encode task={config.new}")
    console.print(f"\n{file} is written. Next:  " + "  ;  ".join(steps))


def _from(folder: Path, name: str) -> str:
    """How a file of a folder names a task or a robot: by a path from there if it is one."""
    return os.path.relpath(Path(name).absolute(), folder.absolute()) if is_path(name) else name


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
