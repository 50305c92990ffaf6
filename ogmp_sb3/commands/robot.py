"""``ogmp-robot``: write the robot.yaml of somebody's model of a legged robot."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.check import DROP, mirror_image, stance
from ogmp_sb3.config.catalogue import shipped
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.model_file import MENAGERIE, PACKAGE
from ogmp_sb3.env.mirror import joint_mirror
from ogmp_sb3.env.robot_check import stand
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.porting.port import PHYSICS_DT, Given, Port, port
from ogmp_sb3.porting.robot_yaml import robot_yaml
from ogmp_sb3.report.plots.robot import draw_robot
from ogmp_sb3.runs.atomic import replacing

PROGRAM = "ogmp-robot"


@dataclass(frozen=True, kw_only=True)
class RobotCommandConfig:
    """Keys of the command line."""

    model: str = cli.option("MJCF or URDF file, package:<package>/<path>, or menagerie:<robot>[/<model>]")
    name: str = cli.option("of the robot")
    out: str | None = cli.option("directory to write; null: robots/<name>, where it is found by name", None)
    base: str | None = cli.option("body that moves freely; null: the one of the model", None)
    feet: tuple[str, ...] | None = cli.option("bodies that stand on the ground; null: the lowest limbs", None)
    kp: float | None = cli.option("of all servos, N m/rad; null: the model's own, or from torque limits", None)
    kd: float | None = cli.option("of all servos, N m s/rad; null: as kp", None)
    torque: float | None = cli.option("greatest torque of all servos, N m; null: as in the model", None)
    replace: bool = cli.option("true: write over a robot.yaml that is there", False)

    def __post_init__(self) -> None:
        for key in ("kp", "kd", "torque"):
            value = getattr(self, key)
            if value is not None and not value > 0:
                raise ValueError(f"'{key}' must be above 0, found {value:g}.")
        cli.check_name("name", self.name)
        if self.feet is not None and len(set(self.feet)) < max(1, len(self.feet)):
            raise ValueError("'feet' must name bodies, each once; leave it out to have them found.")


HELP = cli.usage(
    PROGRAM,
    "write the robot.yaml of a model: find base, legs, feet, a pose to stand in, servos and the single rigid body.",
    [
        "ogmp-robot my_robot.xml name=my_robot",
        "ogmp-robot menagerie:unitree_go2 name=go2",
        "ogmp-robot model=my_robot.urdf name=my_robot kp=80 kd=2",
        "ogmp-robot my_robot.xml name=my_robot feet=[left_foot,right_foot] replace=true",
    ],
    RobotCommandConfig,
)


def _run(arguments: list[str]) -> None:
    names = [a for a in arguments if "=" not in a]
    if len(names) > 1:
        raise ValueError(f"give one model; found '{names[0]}' and '{names[1]}'.")
    keys = [*(f"model={name}" for name in names), *(a for a in arguments if a not in names)]
    config, _ = cli.parse(RobotCommandConfig, keys, PROGRAM)
    if config.name in shipped("robot"):
        raise ValueError(f"'{config.name}' ships with ogmp_sb3: give another name.")
    folder = Path(config.out) if config.out else Path("robots") / config.name
    file = folder / "robot.yaml"
    if file.exists() and not config.replace:
        raise ValueError(f"{file} is there already: give another name, or replace=true.")
    given = Given(config.base, config.feet or (), config.kp, config.kd, config.torque)
    found = port(_from(folder, config.model), config.name, folder, given)
    text = robot_yaml(found)
    cli.check_out(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(file) as written:
        written.write_text(text, encoding="utf-8")
        load_robot(str(written.absolute()))
    console = cli.console()
    console.print(_table(found))
    console.print(str(draw_robot(found, folder / "robot.png")))
    console.print(f"{file} is written. Change in it what is not right, and look at the picture.")


def _from(folder: Path, model: str) -> str:
    """How robot.yaml names a model: a file near it by a path from there, any other by its whole path."""
    if model.startswith((PACKAGE, MENAGERIE)):
        return model
    path = Path(model).expanduser().absolute()
    if not path.is_file():
        raise ValueError(f"{model}: {'a directory, not a model' if path.is_dir() else 'no such file'}.")
    relative = os.path.relpath(path, folder.absolute())
    return relative if relative.count("..") <= 2 else str(path)


def _table(found: Port) -> Table:
    """What was found, what was assumed, and whether the robot stands."""
    robot, legs, posture = found.robot, found.anatomy.legs, found.posture
    table = Table(title=f"{robot.name}: {robot.mjcf}", title_justify="left", show_header=False)
    table.add_row("base", robot.base)
    for leg in legs:
        table.add_row(f"leg to {leg.foot}", f"{len(leg.joints)} joints: {', '.join(leg.joints)}")
    if not found.forwards:
        table.add_row("forwards", "no leg bends forwards: is x not the direction in which the robot looks?")
    if found.anatomy.passive:
        moved = ", ".join(found.anatomy.passive)
        table.add_row("passive", f"no motor: {moved}. Neither held nor observed; an episode begins with them at 0.")
    if robot.hold:
        table.add_row("held", f"{len(robot.hold)} joints: {', '.join(robot.hold)}")
    table.add_row(
        "nominal pose", f"{posture.source}; base at {robot.nominal_height:g} m, legs of {robot.leg_length:g} m"
    )
    table.add_row("servos", found.servos)
    inertia = ", ".join(f"{value:.3g}" for value in robot.srb.inertia)
    table.add_row("single rigid body", f"{robot.srb.mass:.4g} kg, inertia {inertia} kg m^2")
    model = build_model(robot, PHYSICS_DT, 1)
    table.add_row("mirror image", mirror_image(robot, model, lambda: joint_mirror(robot, model)))
    standing, dropped = stand(robot, PHYSICS_DT, (0.0, DROP))
    table.add_row("held for 1 s", stance(standing))
    table.add_row(f"dropped {DROP:g} m", stance(dropped))
    return table


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
