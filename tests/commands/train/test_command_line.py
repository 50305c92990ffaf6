"""The command line of ogmp-train before Hydra reads it, and Hydra's errors as sentences."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
import yaml
from hydra.errors import ConfigCompositionException, HydraException

from helpers.mutations import SHIPPED, check_sentence
from helpers.programs import SMALL, program
from ogmp_sb3.commands.train.command_line import FULL_ERROR, checked, quoted, read_by_hydra, run_hydra, sentence
from ogmp_sb3.config.catalogue import TASKS_DIR

DIVE = [SHIPPED["dive"]]

# ---- checked ----


def test_a_right_command_line_stays_as_it_is_with_hydras_options_in_front() -> None:
    given = [
        "task=dive",
        "rho=0.1,0.2",
        "-m",
        "ppo.gamma=0.9",
        "task.modes.flip.h=[1,2]",
        "hydra.run.dir=x",
        "+a=1",
        "hydra/launcher=basic",
    ]
    assert checked(given, DIVE) == ["-m", *(argument for argument in given if argument != "-m")]


def test_a_key_that_a_task_file_leaves_out_is_added_by_force() -> None:
    assert checked(["task.curriculum.step=0.1"], DIVE) == ["++task.curriculum.step=0.1"]
    assert checked(["task.modes.flop.h=1"], DIVE) == ["++task.modes.flop.h=1"]
    assert checked(["task.rho=1"], [*DIVE, {}]) == ["++task.rho=1"]
    assert checked(["task.rho=1"], []) == ["++task.rho=1"]


def test_a_key_of_the_task_stays_as_it_was_typed_with_task_or_without() -> None:
    for given in ("modes.flop.h=1", "+modes.flop.h=1", "++curriculum.step=0.1", "curriculum=null", "rho=0.3"):
        assert checked([given], DIVE) == [given]
    assert checked(["~modes.flip"], DIVE) == checked(["~task.modes.flip"], DIVE) == ["~task.modes.flip"]


@pytest.mark.parametrize("pair", [("rho=0.1", "task.rho=0.1"), ("+task.modes.flip.h=1", "modes.flip.h=1")])
def test_a_key_in_two_spellings_is_refused_and_the_last_of_one_spelling_counts(pair: tuple[str, str]) -> None:
    with pytest.raises(ValueError, match=f"'{pair[1].removeprefix('task.').partition('=')[0]}' is given twice"):
        checked(list(pair), DIVE)
    assert checked(["rho=0.1", "rho=0.2"], DIVE) == ["rho=0.1", "rho=0.2"]


@pytest.mark.parametrize("name", ["läufe/1", "walk (1)", "a [1]", "it's", 'say "hi"', "步态", "rho=0.3,seed=1"])
def test_a_path_of_any_name_is_text_to_hydra(name: str) -> None:
    keys = ["hydra.run.dir", "hydra.sweep.dir", *["encoder", "task.robot"] * ("," not in name)]
    for key in keys:
        (argument,) = checked([f"{key}={name}"], DIVE)
        override = read_by_hydra(argument)
        assert override is not None and override.value() == name


@pytest.mark.parametrize("text", ["a", "it's", "\\", "a\\'b", "a\\", "", "'"])
def test_quoted_text_is_read_as_it_was(text: str) -> None:
    override = read_by_hydra(f"key={quoted(text)}")
    assert override is not None and override.value() == text


def test_a_configuration_of_ones_own_may_have_other_keys() -> None:
    assert checked(["--config-name", "mine", "other=1"], DIVE) == ["--config-name", "mine", "other=1"]


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("min_step_reard=null", "Did you mean 'min_step_reward=null'?"),
        ("mode.flip.h=1", "Did you mean 'modes.flip.h=1'?"),
        ("modes.flop.h=1", "unknown mode 'flop'"),
        ("num_env=3", "Did you mean 'num_envs=3'?"),
        ("gamma=0.9", "Did you mean 'ppo.gamma=0.9'?"),
        ("tsak=dive", "Did you mean 'task=dive'?"),
        ("ppo.gama=0.9", "'ppo.gama' is not a known key (allowed: ppo.asymmetric_noise, "),
        ("zzz=1", "'zzz' is not a known key (allowed: checkpoint_interval, "),
        ("rho.x=1", "'rho' is the number 0.3: it has no 'x' to set."),
        ("task.min_step_reard=1", "tasks/dive.yaml: 'min_step_reard' is not a known key"),
        ("task.rho.x=3", "'rho' is the number 0.3: it has no 'x' to set."),
        ("task.modes.flip.h.low=3", "'modes.flip.h' is the list [1.0, 1.75]: it has no 'low' to set."),
        ("num_envs=many", "'num_envs' must be a whole number, found the text 'many'."),
        ("ppo.gamma=1.5", "'ppo': 'gamma' must be at most 1, found 1.5."),
        ("seed=4294967296", "'seed' must be at most 4,294,967,295, found 4.29497e+09."),
        ("experiment=x", "write '+experiment=x'."),
        ("+experiment=rhoo", "unknown experiment 'rhoo' (allowed: "),
        ("+experiment=paper/diev", "Did you mean 'paper/dive'?"),
        ("+foo=3", "'foo' is not a known key (allowed: "),
        (
            "task=dvie",
            "unknown task 'dvie' (allowed: dive, dive_robot, parkour, parkour_robot, stairs). Did you mean 'dive'?",
        ),
        ("rho=0.1,0.2", "'rho=0.1,0.2' has several values: add -m to train each of them"),
        ("rho", "'rho' must have the form key=value as Hydra reads it: missing EQUAL at '<EOF>'."),
        ("rho=[", "'rho=[' must have the form key=value as Hydra reads it: "),
        ("rho=${foo}", "tasks/dive.yaml: 'rho': '${foo}' has no value (Interpolation key 'foo' not found)."),
        ("task.rho=${foo}", "tasks/dive.yaml: 'rho': '${foo}' has no value (Interpolation key 'foo' not found)."),
        ("seed=${foo}", "'seed': '${foo}' has no value (Interpolation key 'foo' not found)."),
        ("hydra.foo=1", "Could not override 'hydra.foo'."),
        ("--foo", "unknown option '--foo'"),
        ("--cfg=foo", "argument --cfg/-c: invalid choice: 'foo'"),
        ("~task", "'~task': a training needs a task."),
        ("~seed", "'seed' is missing"),
    ],
)
def test_a_mistake_is_one_sentence_with_key_and_closest_match(argument: str, expected: str, tmp_path: Path) -> None:
    done = program("train", "task=dive", "hydra.run.dir=run", argument, cwd=tmp_path)
    assert done.returncode == 2
    assert expected in done.stderr
    assert done.stderr.startswith("ogmp-train: ") and done.stderr.count("ogmp-train: ") == 1
    check_sentence(done.stderr.removesuffix("\n"))


def test_a_missing_task_is_one_sentence(tmp_path: Path) -> None:
    done = program("train", "rho=0.1", cwd=tmp_path)
    assert done.returncode == 2
    assert "'task' is missing: give task=<name> or task=<file> (allowed: dive, " in done.stderr
    assert "parkour, parkour_robot, stairs" in done.stderr  # beside those that other tests of this process have named


def test_keys_that_the_file_leaves_out_reach_the_training(tmp_path: Path) -> None:
    keys = ["task.randomisation.mass.scale=0.9", "task.curriculum.step=0.1", "task.sampling.weights.flip=2"]
    done = program("train", "task=dive", *keys, "total_timesteps=64", "hydra.run.dir=run", *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    data = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["task"]
    assert data["randomisation"] == {"mass": {"scale": 0.9}}
    assert data["curriculum"] == {"step": 0.1}
    assert data["sampling"]["weights"] == {"flip": 2}


@pytest.mark.parametrize("option", ["--config-dir", "-cd"])
def test_a_task_is_found_in_a_directory_of_any_name(option: str, tmp_path: Path) -> None:
    folder = tmp_path / "conf dir [a], b=c" / "task"
    folder.mkdir(parents=True)
    shutil.copy(TASKS_DIR / "dive.yaml", folder / "hop.yaml")
    done = program("train", "task=hop", option, folder.parent.name, "--cfg", "job", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "rho: 0.3" in done.stdout


# ---- run_hydra, sentence ----


def test_what_hydra_would_print_is_raised_and_its_variable_is_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        assert os.environ[FULL_ERROR] == "1"
        raise HydraException("one\ntwo")

    monkeypatch.delenv(FULL_ERROR, raising=False)
    with pytest.raises(ValueError, match=r"^one two\.$"):
        run_hydra(fails)
    assert FULL_ERROR not in os.environ


def test_who_wants_hydras_whole_error_gets_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise HydraException("one")

    monkeypatch.setenv(FULL_ERROR, "1")
    with pytest.raises(HydraException):
        run_hydra(fails)
    assert os.environ[FULL_ERROR] == "1"


def test_a_sentence_has_no_links_and_no_types() -> None:
    error = ConfigCompositionException("Could not do it.\n\tSee https://hydra.cc/x for details\n  full_key: a\n")
    assert sentence(error) == "Could not do it."
