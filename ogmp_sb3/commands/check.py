"""``ogmp-check``: is a task file right, what can it name, and what do its references look like?"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.encoder_warning import encoder_warning
from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import find, is_file, shown_path
from ogmp_sb3.config.editor_schema import task_schema
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.plugins import load_plugins
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.robot import SRB, RobotConfig
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import extended_files, read_task
from ogmp_sb3.config.yaml_files import apply_overrides
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.failed_step import replay
from ogmp_sb3.env.mirror import Mirror, mirror_error, mirrors
from ogmp_sb3.env.robot_check import Stand, foot_clearance, model_srb, stand
from ogmp_sb3.evaluation.evaluate import metric_names
from ogmp_sb3.guidance.admissible import admissible_rho
from ogmp_sb3.guidance.plans import make_oracle, segment_set_points, start_state
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.report.plots.guidance import plot_references
from ogmp_sb3.runs.failed_steps import load_step
from ogmp_sb3.runs.storage import save_json

PROGRAM = "ogmp-check"
DROP = 0.1  # m
LONGEST = 10.0  # s, of a reference along the track that is drawn: at rest it has no end
PLACE = ("num_timesteps", "environment", "seed", "control_step")  # of a step in which a simulation failed
DECIDING = ("ogmp_sb3", "mujoco")  # versions that a simulation depends on
INITIAL_UNITS = {"x": "m", "y": "m", "yaw": "rad", "joint_pos": "rad", "velocity": "m/s"}
SAME = 0.01  # relative difference up to which a robot's file and model agree
DEEPEST, HIGHEST = -0.02, 0.3  # m above the ground, of the lowest foot at the nominal height
FALLEN = np.radians(60.0)  # tilt from which a robot does not stand


@dataclass(frozen=True, kw_only=True)
class CheckConfig:
    """Keys of the command line."""

    task: str | None = cli.option("a task by name or the path of a YAML file; without the key, one or more", None)
    unstable: str | None = cli.option("file of a step in which a simulation failed, to replay: <run>/unstable/*", None)
    schema: str | None = cli.option("file for the JSON Schema of task files, for editors; needs no task", None)
    out: str | None = cli.option("directory for references.png; null: no picture", None)

    def __post_init__(self) -> None:
        if self.task is None and self.schema is None and self.unstable is None:
            raise ValueError(
                "give a task to check (ogmp-check parkour), an 'unstable' step to replay, or a 'schema' to write."
            )


HELP = cli.usage(
    PROGRAM,
    "validate a task file, list what one can name, and draw the references of its modes.",
    [
        "ogmp-check parkour",
        "ogmp-check path/to/my_task.yaml out=check",
        "ogmp-check tasks/*.yaml",
        "ogmp-check dive rho=0.1 oracle=lqr",
        "ogmp-check unstable=runs/parkour/2026-01-31_12-00-00/unstable/000000123456-7.safetensors",
        "ogmp-check schema=task.schema.json",
    ],
    CheckConfig,
    "any other key of the task file",
)


def reference_panels(task: TaskConfig) -> list[tuple[str, np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """References of every mode in the middle of its ranges, by every oracle the task has parameters for.

    A mode has one for each of its words: a flip is another one to the side than to the front.
    """
    panels = []
    for call in _middle_calls(task):
        segment = call.segment()
        speed = segment.spans[0].velocity[0]
        duration = segment.length / speed if speed > 0 else LONGEST
        duration = segment.spans[-1].end if segment.timed else min(duration, LONGEST)
        x0 = start_state(task, segment)
        points = segment_set_points(task, [segment], x0, max(1, round(duration / task.control_dt)))
        references = {
            oracle: make_oracle(replace(task, oracle=oracle))(points, x0).state[0]
            for oracle in sorted({*task.oracle_params, task.oracle})
        }
        texts = [value if isinstance(value, str) else f"{key} {value:g}" for key, value in call.parameters.items()]
        title = f"{call.name} ({', '.join(texts)})" if texts else call.name
        panels.append((title, points.stance[0], points.state[0], references))
    return panels


def _middle_calls(task: TaskConfig) -> Iterator[ModeCall]:
    """Every mode in the middle of its ranges, with each of its words."""
    for name, ranges in task.mode_ranges.items():
        values: list[tuple[float | str, ...]] = [
            range_.words or (0.5 * (range_.low + range_.high),) for range_ in ranges.values()
        ]
        for chosen in itertools.product(*values):
            yield ModeCall(name, dict(zip(ranges, chosen, strict=True)))


def mirror_image(robot: RobotConfig, model: mujoco.MjModel, find: Callable[[], Mirror]) -> str:
    """How symmetric a robot is, or why it, or what is observed of it, has no mirror image.

    :param model: of :func:`~ogmp_sb3.env.robot_model.build_model`
    :param find: gives the mirror image of the joints
    """
    try:
        joints = find()
    except ValueError as error:
        return f"none: {error}"
    difference = mirror_error(robot, model, joints)
    return f"left and right differ by at most {100 * difference:.2g} % of the mass matrix"


def _describe(task: TaskConfig, env: BatchEnv, console: Console) -> None:
    table = Table(title=f"{task.file}: {task.description}", title_justify="left", show_header=False)
    for name, ranges in task.mode_ranges.items():
        table.add_row(f"mode {name}", ", ".join(f"{key} {_range_text(r)}" for key, r in ranges.items()))
    rho = "off" if task.rho is None else f"{task.rho:g} on {', '.join(k for k, w in task.bound.items() if w)}"
    table.add_row("oracle", f"{task.oracle}, horizon {task.horizon or 'one mode'}, rho {rho}")
    table.add_row("observation", f"{env.observation_size} numbers: {_names(task.observations)}")
    if any(parameters is not None for parameters in task.critic_observations.values()):
        numbers = env.critic_observation().shape[1]
        table.add_row("critic alone", f"{numbers} numbers: {_names(task.critic_observations)}")
    table.add_row("reward", _names(task.rewards))
    table.add_row("action", f"{env.action_size} joint targets, nominal +- {task.action.scale:g} rad")
    for title, initial in (("initial state", task.initial), ("initial state, test", task.evaluation.initial)):
        if initial is not None:
            drawn = ((name, getattr(initial, name)) for name in INITIAL_UNITS)
            texts = (f"{name} {_range_text(r)} {INITIAL_UNITS[name]}" for name, r in drawn if r is not None)
            table.add_row(title, ", ".join(texts))
    for title, terms in (("randomisation", task.randomised), ("randomisation, test", task.evaluation.randomised)):
        if terms:
            table.add_row(title, ", ".join(_disturbance_text(*term) for term in terms.items()))
    robot = task.robot_config
    table.add_row("robot", f"{robot.name}: {rigid_body(robot, model_srb(robot, env.sim.model))}")
    table.add_row("mirror image", mirror_image(robot, env.sim.model, lambda: mirrors(env).action))
    wrong_height = height(robot, foot_clearance(robot, task.physics_dt))
    if wrong_height:
        table.add_row("nominal height", wrong_height)
    standing, dropped = stand(robot, task.physics_dt, (0.0, DROP))
    table.add_row("nominal pose", f"held for 1 s: {stance(standing)}")
    table.add_row(f"dropped {DROP:g} m", f"after 1 s: {stance(dropped)}")
    in_test = f" (in the test {task.test_physics_dt:g} s)" if task.test_physics_dt != task.physics_dt else ""
    table.add_row("time", f"control {task.control_dt:g} s, physics {task.physics_dt:g} s{in_test}")
    admissible = admissible_rho(task)
    table.add_row("admissible rho", admissible.judged(task.rho))
    if admissible.left_out:
        left_out = f"{admissible.left_out} of {admissible.queries} have a contact schedule that no body can keep to"
        table.add_row("references", left_out)
    for behaviour in admissible.behaviours:
        table.add_row(behaviour.name, behaviour.judged(task.rho))
    console.print(table)


def rigid_body(robot: RobotConfig, model: SRB) -> str:
    """A robot's mass and inertia, and what ``srb`` in robot.yaml must be if it is not that of the model."""
    declared = robot.srb
    if np.allclose((declared.mass, *declared.inertia), (model.mass, *model.inertia), rtol=SAME):
        return f"{model.mass:.4g} kg, {len(robot.joints)} joints, srb as in the model"
    inertia = ", ".join(f"{value:.6f}" for value in model.inertia)
    return f"srb in {robot.path.name} should be {{mass: {model.mass:.6g}, inertia: [{inertia}]}}"


def height(robot: RobotConfig, clearance: float) -> str | None:
    """What ``nominal_height`` in robot.yaml must be, if it puts the feet far from the ground.

    :param clearance: of the lowest foot, m
    """
    if DEEPEST <= clearance <= HIGHEST:
        return None
    place = f"{abs(clearance):.2f} m {'above' if clearance > 0 else 'under'} the ground"
    return f"{robot.nominal_height - clearance:.3f} in {robot.path.name} puts the feet on the ground; they are {place}"


def stance(stand: Stand) -> str:
    """What became of a robot on its servos alone."""
    if stand.unstable:
        return "the simulation is unstable"
    if stand.height < 0.0:
        feet = "fell through the ground"
    elif stand.body_contact:
        feet = "other bodies than feet touched the ground"
    elif not stand.feet_contact:
        feet = "no foot touches the ground"
    else:
        feet = "on its feet" if stand.tilt < FALLEN else "fallen over"
    return f"base at {stand.height:.2f} m, tilted {np.degrees(stand.tilt):.0f}°, {feet}"


def _names(terms: dict[str, dict[str, object] | None]) -> str:
    return ", ".join(name for name, parameters in terms.items() if parameters is not None)


def _disturbance_text(name: str, ranges: dict[str, Range]) -> str:
    return f"{name} ({', '.join(f'{key} {_range_text(range_)}' for key, range_ in ranges.items())})"


def _range_text(range_: Range) -> str:
    if range_.words:
        return "/".join(range_.words)
    return f"{range_.low:g}" if range_.low == range_.high else f"{range_.low:g}..{range_.high:g}"


def _run(arguments: list[str]) -> None:
    names = [a for a in arguments if "=" not in a or (a.endswith(".yaml") and is_file(Path(a)))]
    keys = [*(f"task={name}" for name in names[:1]), *(a for a in arguments if a not in names)]
    config, overrides = cli.parse(CheckConfig, keys, PROGRAM, cli.task_keys(TaskConfig))
    if len(names) > 1 and config.out:
        raise ValueError("'out' takes the picture of one task: check them one by one.")
    if config.out:
        cli.check_out(Path(config.out))
    console = cli.console()
    if config.schema:
        save_json(Path(config.schema), task_schema())
        console.print(config.schema)
    if config.unstable:
        _replay(Path(config.unstable), console)
    for name in filter(None, (config.task, *names[1:])):
        path = find("task", name)
        data = apply_overrides(read_task(path), overrides, shown_path(path))
        task = task_from_data(data, path)
        _check(task, extended_files(path), config.out, console)
        warning = encoder_warning(task, data, path)
        if warning:
            console.print(f"Warning: {warning}")
        console.print(f"{task.file} is right.")


def _check(task: TaskConfig, extended: list[Path], out: str | None, console: Console) -> None:
    env = BatchEnv(task, num_envs=1)
    env.reset()
    env.step(np.zeros((1, env.action_size)))  # the first answers of the oracle and the terms are checked
    metric_names(task)
    if extended:
        console.print(f"{task.file} extends {', which extends '.join(map(shown_path, extended))}.")
    _describe(task, env, console)
    known = Table(title="What a task file can name", title_justify="left", show_header=False)
    for kind in registry.KINDS:
        known.add_row(f"{kind.kind}s", ", ".join(f"{n}({', '.join(kind.parameters(n))})" for n in kind.names()))
    for plugin in load_plugins():
        state = plugin.version if plugin.error is None else f"{plugin.version}, broken: {plugin.error}"
        known.add_row(f"plug-in {plugin.name}", f"{plugin.distribution} {state}")
    console.print(known)
    if out:
        path = Path(out) / "references.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        plot_references(reference_panels(task), task.control_dt, path)
        console.print(str(path))


def _replay(file: Path, console: Console) -> None:
    """Say what happened in a control step in which a simulation failed."""
    step, task = load_step(file)
    replayed, info = replay(step, task), step.info
    table = Table(title=str(file), title_justify="left", show_header=False)
    place = ", ".join(f"{key.replace('_', ' ')} {info[key]}" for key in PLACE if key in info)
    table.add_row("where", f"task {task.name}, {place}")
    table.add_row("versions", ", ".join(f"{name} {info.get('versions', {}).get(name)}" for name in DECIDING))
    joint, speed = replayed.fastest
    table.add_row("before", f"base at {replayed.height:.2f} m; the fastest joint is {joint} with {speed:.3g} rad/s")
    table.add_row("action", f"largest {np.abs(step.action).max():.3g}")
    if replayed.failed_at is None:
        table.add_row("replayed", "the simulation does not fail here: other versions, or another robot or task file?")
    else:
        table.add_row("replayed", f"fails in physics step {replayed.failed_at} of {replayed.substeps}")
        for text in replayed.reasons:
            table.add_row("why", text)
    console.print(table)


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
