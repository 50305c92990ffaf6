"""Keys of the task with ``task.`` and without come to the same, and a mapping for the bound replaces it whole."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra._internal.utils import create_config_search_path
from hydra.core.utils import JobRuntime
from hydra.types import RunMode
from omegaconf import OmegaConf

from helpers.mistakes import SHIPPED
from helpers.programs import SMALL, program
from ogmp_sb3.commands.train.command_line import PAPER, TASK_KEYS, checked
from ogmp_sb3.commands.train.composition import Composition
from ogmp_sb3.commands.train.tasks import register_tasks, registered_data
from ogmp_sb3.config.catalogue import ROBOTS_DIR, TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.settings import TrainConfig


def trained(folder: Path, *arguments: str) -> dict[str, Any]:
    done = program("train", "task=dive", "total_timesteps=64", *SMALL, *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return {file.parent.name: yaml.safe_load(file.read_text())["task"] for file in folder.rglob("config.yaml")
            if file.parent.name != ".hydra"}  # fmt: skip


@pytest.mark.parametrize("given", [["modes.flip.h=[1.0,1.1]", "rho=null", "feedback=[z]", "+sampling.weights.flip=2"],
                                   ["curriculum={}", "observations={clock:null}", "restarts=null"]])  # fmt: skip
def test_a_key_means_the_same_with_task_and_without(given: list[str], tmp_path: Path) -> None:
    prefixed = [argument.replace("+", "+task.") if "+" in argument else f"task.{argument}" for argument in given]
    trained(tmp_path, *given, "hydra.run.dir=bare")
    found = trained(tmp_path, *prefixed, "hydra.run.dir=prefixed")
    assert found["bare"] == found["prefixed"]


def test_a_sweep_names_its_directories_by_what_was_typed_and_the_same_command_finds_them(tmp_path: Path) -> None:
    arguments = ["-m", "modes.flip.h=1.0,1.1", "hydra.sweep.dir=sweep"]
    first = trained(tmp_path, *arguments)
    assert sorted(task["modes"]["flip"]["h"] for task in first.values()) == [1.0, 1.1]
    assert {name.partition(",num_envs")[0] for name in first} == {"modes.flip.h=1.0", "modes.flip.h=1.1"}
    done = program("train", "task=dive", "total_timesteps=64", *SMALL, *arguments, cwd=tmp_path)
    assert done.stdout.count("already") == 2


def test_no_setting_of_a_training_has_the_name_of_a_key_of_the_task() -> None:
    assert not set(TASK_KEYS) & set(TrainConfig.__dataclass_fields__)


# ---- what replaces and what merges ----

DIVE = {"z": 1.0, "wx": 0.025, "wy": 0.025}  # as in tasks/dive.yaml
EXPERIMENTS = {
    "mapping": {"task": {"bound": {"z": 1.0}}},
    "bare": {"bound": {"z": 3.0}},
    "other": {"defaults": ["mapping"], "task": {"rho": 0.2, "modes": {"flip": {"h": 1.2}}}},
    "over": {"defaults": ["mapping", "_self_"], "task": {"bound": {"x": 1.0, "z": 0.5}}},
}

EXTENDING = {
    "slower": {"extends": "parkour", "rho": 0.4, "bound": {"z": 2.0}, "modes": {"jump": {"h": 0.3}, "leap": None}},
    "slowest": {"extends": "slower.yaml", "modes": {"pace": {"v": 0.5}}, "gait": None},
    "round": {"extends": "round.yaml"},
}


@cache
def registered() -> list[dict[str, Any]]:
    """The shipped tasks are known to Hydra."""
    return registered_data(register_tasks(["task=dive"])[1])


def composed(arguments: list[str], mode: RunMode = RunMode.RUN, config_dir: str = "") -> dict[str, Any]:
    """What Hydra makes of a command line of ogmp-train, without training."""
    words = [word for word in checked(arguments, registered()) if not word.startswith("-")]
    paths = create_config_search_path("pkg://ogmp_sb3.conf")
    if config_dir:
        paths.prepend("command-line", config_dir)
    JobRuntime.instance().set("name", "train")
    return OmegaConf.to_container(Composition(paths).load_configuration("train", words, mode))  # type: ignore[return-value]


@pytest.fixture(scope="module")
def user(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A directory for ``--config-dir``, with experiments and a task of the user's."""
    folder = tmp_path_factory.mktemp("conf")
    (folder / "experiment").mkdir()
    (folder / "task").mkdir()
    for name, data in EXPERIMENTS.items():
        (folder / "experiment" / f"{name}.yaml").write_text(f"# @package _global_\n{yaml.safe_dump(data)}")
    (folder / "task" / "mine.yaml").write_text((TASKS_DIR / "dive.yaml").read_text())
    for name, data in EXTENDING.items():
        (folder / "task" / f"{name}.yaml").write_text(yaml.safe_dump(data))
    return str(folder)


@pytest.mark.parametrize(
    "task, given, bound",
    [
        ("dive", ["bound={z:1.0}"], {"z": 1.0}),
        ("dive", ["task.bound={z:1.0}"], {"z": 1.0}),
        ("dive", ["++task.bound={z:1.0}"], {"z": 1.0}),
        ("dive", ["task.bound={x:2}", "bound.y=3"], {"x": 2, "y": 3}),
        ("dive", ["bound.y=3", "task.bound={x:2}"], {"x": 2}),
        ("dive", ["bound.z=2.0"], {**DIVE, "z": 2.0}),
        ("dive", ["task.bound.y=2.0", "~bound.wx"], {"z": 1.0, "wy": 0.025, "y": 2.0}),
        ("dive", ["bound={}"], {}),
        ("dive", ["bound=null"], None),
        ("dive", ["+experiment=bare", "task.bound.wx=0.1"], {"z": 3.0, "wx": 0.1}),
        ("dive", ["+experiment=other"], {"z": 1.0}),
        ("dive", ["+experiment=over"], {"x": 1.0, "z": 0.5}),
        ("dive", ["+experiment=mapping", "bound={y:1.0}"], {"y": 1.0}),
        ("mine", [], DIVE),  # a task that Hydra finds itself
        ("mine", ["task.bound={z:1.0}"], {"z": 1.0}),
        ("mine", ["+experiment=mapping", "bound.wx=0.1"], {"z": 1.0, "wx": 0.1}),
    ],
)
def test_a_mapping_for_the_bound_replaces_it_and_a_single_weight_does_not(
    task: str, given: list[str], bound: Any, user: str
) -> None:
    assert composed([f"task={task}", *given], config_dir=user)["task"]["bound"] == bound


def test_other_mappings_merge(user: str) -> None:
    task = composed(["task=dive", "+experiment=other", "task.rewards.body_contact={weight:-0.1}"], config_dir=user)[
        "task"
    ]
    assert task["rho"] == 0.2
    assert task["modes"]["flip"] == {"r": ["front", "back", "left", "right"], "h": 1.2}
    assert task["rewards"]["body_contact"] == {"weight": -0.1}
    assert task["rewards"]["torque_regulation"] == {"weight": 0.05, "sharpness": 0.01}


def test_values_of_a_sweep_are_left_to_its_jobs() -> None:
    assert composed(["task=dive", "bound={z:1},{x:1}", "-m"], RunMode.MULTIRUN)["task"]["bound"] == DIVE


def test_a_bound_reaches_the_file_of_a_run_as_it_is_trained(tmp_path: Path) -> None:
    found = trained(tmp_path, "-m", "bound={z:1.0},{x:1.0,wx:0.1}", "hydra.sweep.dir=sweep")
    bounds = sorted((task["bound"] for task in found.values()), key=str)
    assert bounds == [{"x": 1.0, "wx": 0.1}, {"z": 1.0}]


# ---- tasks that extend others ----


@pytest.mark.parametrize("name", ["slower", "slowest"])
def test_a_task_that_extends_another_and_that_hydra_finds_itself_is_composed_of_both(name: str, user: str) -> None:
    composed_task = composed([f"task={name}", "rho=0.1"], config_dir=user)["task"]
    assert composed_task == read_task(Path(user) / "task" / f"{name}.yaml")
    assert "extends" not in composed_task
    assert (composed_task["rho"], composed_task["bound"], composed_task["modes"]["leap"]) == (0.4, {"z": 2.0}, None)


def test_what_is_typed_goes_into_the_merged_task(user: str) -> None:
    given = ["task=slower", "task.modes.jump.w=0.4", "bound.x=1.0", "+experiment=other"]
    task = composed(given, config_dir=user)["task"]
    assert task["modes"]["jump"] == {**SHIPPED["parkour"]["modes"]["jump"], "h": 0.3, "w": 0.4}
    assert task["bound"] == {"z": 1.0, "x": 1.0}  # the experiment's, and one more
    with pytest.raises(KeyError, match=r"'extends' is for task files: what a task extends cannot be overridden"):
        task_from_data(composed(["task=dive", "task.extends=parkour"])["task"], TASKS_DIR / "dive.yaml")


def test_a_mistake_in_what_is_extended_is_one_sentence(user: str, tmp_path: Path) -> None:
    for arguments in (["task=round", "--config-dir", user], [f"task={user}/task/round.yaml"]):
        done = program("train", *arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith(f"ogmp-train: {user}/task/round.yaml: 'extends' leads back to the same file: ")
        assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_run_keeps_the_merged_task_and_needs_the_files_no_more(tmp_path: Path) -> None:
    shutil.copytree(ROBOTS_DIR / "hector", tmp_path / "bases" / "robot")
    (tmp_path / "bases" / "base.yaml").write_text("extends: dive\nrobot: robot/robot.yaml\nrho: 0.2")
    (tmp_path / "mine.yaml").write_text("extends: bases/base.yaml\nmodes: {flip: {h: 1.2}}")
    merged = read_task(tmp_path / "mine.yaml")
    arguments = ["task=mine.yaml", "total_timesteps=64", *SMALL, "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    stored = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["task"]
    assert {**stored, "encoder": "dive"} == merged
    assert stored["robot"] == str(tmp_path / "bases" / "robot" / "robot.yaml")
    shutil.rmtree(tmp_path / "bases")
    (tmp_path / "mine.yaml").unlink()
    task = load_policy(tmp_path / "run").task
    assert (task.name, task.rho, task.mode_ranges["flip"]["h"].high) == ("mine", 0.2, 1.2)


# ---- the paper's settings ----


def of_paper(name: str, *arguments: str) -> tuple[TaskConfig, dict[str, Any]]:
    config = composed([f"+experiment=paper/{name}", *arguments])
    return task_from_data(config["task"], TASKS_DIR / f"{name}.yaml"), config


@pytest.mark.parametrize("name, bound, rho", [("parkour", {"x": 1.0}, 0.5), ("dive", {"z": 1.0}, 0.1)])
def test_the_paper_s_settings_choose_their_task_and_are_as_the_paper_says(
    name: str, bound: dict[str, float], rho: float
) -> None:
    task, config = of_paper(name)
    assert (task.bound, task.rho, task.min_step_reward) == (bound, rho, 0.5)
    assert (task.curriculum, task.restarts, task.initial, task.randomisation) == (None, None, None, None)
    assert task.terminations == {"fall": None}
    assert task.physics_dt <= 0.002
    assert (config["ppo"]["n_lstm_layers"], config["ppo"]["lstm_hidden_size"]) == (2, 128)
    speeds = [ranges["v"] for ranges in task.mode_ranges.values() if "v" in ranges]
    assert all((speed.low, speed.high) == (0.8, 0.8) for speed in speeds)
    assert task.for_evaluation().terminations == {"fall": {"min_height": 0.3}}


def test_every_file_of_the_paper_s_settings_is_tested_here() -> None:
    assert {path.stem for path in PAPER.iterdir()} == {"parkour", "dive"}


def test_a_key_that_is_typed_counts_over_the_paper_s() -> None:
    task, _ = of_paper("dive", "task.rho=0.3", "task.min_step_reward=null", "bound.wx=0.1")
    assert (task.rho, task.min_step_reward, task.bound) == (0.3, None, {"z": 1.0, "wx": 0.1})
