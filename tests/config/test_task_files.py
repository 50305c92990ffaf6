"""Task files that extend others: what is merged, where paths start, and which file a mistake names."""

from __future__ import annotations

import copy
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.mistakes import MISSING, SHIPPED, put
from helpers.plugins import lay
from ogmp_sb3 import load_task
from ogmp_sb3.config.catalogue import ROBOTS_DIR
from ogmp_sb3.config.task_files import KEYS, extended_files, merged, read_task, with_extended

PARKOUR = SHIPPED["parkour"]


def write(file: Path, data: Any) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file


def sentence(kind: type[Exception], path: Path | str, overrides: Any = ()) -> str:
    with pytest.raises((ValueError, KeyError, TypeError)) as caught:
        load_task(path, overrides)
    (message,) = caught.value.args
    assert type(caught.value) is kind, message
    assert "\n" not in message and message[-1] in ".?"
    return str(message)


# ---- read_task ----


def test_a_file_that_extends_nothing_is_read_as_it_is(tmp_path: Path) -> None:
    assert read_task(write(tmp_path / "a.yaml", "rho: 1\nmodes: null\n")) == {"rho": 1, "modes": None}


def test_a_task_has_what_it_does_not_say_from_the_one_that_it_extends(tmp_path: Path) -> None:
    own = {"extends": "parkour", "rho": 0.4, "modes": {"jump": {"h": 0.3}}}
    expected = copy.deepcopy(PARKOUR)
    expected["rho"], expected["modes"]["jump"]["h"] = 0.4, 0.3
    assert read_task(write(tmp_path / "mine.yaml", own)) == expected
    task = load_task(tmp_path / "mine.yaml")
    assert (task.name, task.file) == ("mine", str(tmp_path / "mine.yaml"))
    assert task.oracle_params == load_task("parkour").oracle_params


def test_a_file_that_only_extends_is_the_same_task_by_another_name(tmp_path: Path) -> None:
    task, parkour = load_task(write(tmp_path / "mine.yaml", "extends: parkour")), load_task("parkour")
    same = {name: value for name, value in vars(task).items() if name not in ("name", "file")}
    assert same == {name: getattr(parkour, name) for name in same}


def test_files_extend_each_other_in_a_chain_the_nearest_counts(tmp_path: Path) -> None:
    write(tmp_path / "a.yaml", {"extends": "parkour", "rho": 0.1, "horizon": 10, "episode_steps": 100})
    write(tmp_path / "b.yaml", {"extends": "a.yaml", "rho": 0.2, "horizon": 20})
    task = load_task(write(tmp_path / "c.yaml", {"extends": "b.yaml", "rho": 0.3}))
    assert (task.rho, task.horizon, task.episode_steps, task.control_dt) == (0.3, 20, 100, 0.03)


def test_a_path_starts_from_the_file_that_says_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "bases" / "common" / "a.yaml", {"extends": "parkour", "rho": 0.1})
    write(tmp_path / "bases" / "b.yaml", {"extends": "common/a.yaml"})
    write(tmp_path / "mine" / "c.yaml", {"extends": "../bases/b.yaml"})
    monkeypatch.chdir(tmp_path / "mine")
    assert load_task("c.yaml").rho == 0.1
    monkeypatch.chdir("/")
    assert load_task(os.path.relpath(tmp_path / "mine" / "c.yaml", "/")).rho == 0.1
    write(tmp_path / "mine" / "d.yaml", {"extends": str(tmp_path / "bases" / "b.yaml"), "rho": 0.2})
    assert load_task(tmp_path / "mine" / "d.yaml").rho == 0.2


def test_a_file_may_have_the_name_of_the_shipped_task_that_it_extends(tmp_path: Path) -> None:
    assert load_task(write(tmp_path / "dive.yaml", {"extends": "dive", "rho": 0.2})).rho == 0.2


def test_a_task_of_a_plugin_extends_a_shipped_one_and_is_extended(tmp_path: Path, forget: None, monkeypatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    lay(tmp_path, "plug_e", {"__init__.py": "", "tasks/low.yaml": "extends: parkour\nmodes: {jump: {h: 0.1}}"})
    lower = load_task(write(tmp_path / "lower.yaml", {"extends": "low", "modes": {"leap": None}}))
    assert lower.modes["jump"]["h"].high == 0.1 and list(lower.mode_ranges) == ["pace", "jump"]
    assert extended_files(tmp_path / "lower.yaml")[0] == tmp_path / "plug_e" / "tasks" / "low.yaml"


def test_a_value_that_refers_to_another_key_takes_what_the_merged_file_has_there(tmp_path: Path) -> None:
    write(tmp_path / "a.yaml", {"extends": "parkour", "horizon": 10, "episode_steps": "${horizon}"})
    assert load_task(write(tmp_path / "b.yaml", {"extends": "a.yaml", "horizon": 20})).episode_steps == 20


def test_overrides_go_into_the_merged_task(tmp_path: Path) -> None:
    path = write(tmp_path / "mine.yaml", {"extends": "parkour", "modes": {"jump": {"h": 0.3}}})
    assert load_task(path, ["modes.jump.w=0.5", "rho=null"]).modes["jump"]["w"].low == 0.5
    assert "'extends' is for task files" in sentence(KeyError, path, {"extends": "dive"})
    assert "'extends' is for task files" in sentence(KeyError, "parkour", ["extends=dive"])


# ---- where a robot's path starts ----


def test_a_robot_is_relative_to_the_file_that_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, name in (("bases", "first"), ("mine", "second")):
        shutil.copytree(ROBOTS_DIR / "hector", tmp_path / folder / "robot")
        file = tmp_path / folder / "robot" / "robot.yaml"
        file.write_text(re.sub("name: .*", f"name: {name}", file.read_text(), count=1))
    write(tmp_path / "bases" / "a.yaml", {"extends": "parkour", "robot": "robot/robot.yaml"})
    write(tmp_path / "mine" / "b.yaml", {"extends": "../bases/a.yaml", "rho": 0.1})
    write(tmp_path / "mine" / "c.yaml", {"extends": "b.yaml", "robot": "robot/robot.yaml"})
    write(tmp_path / "mine" / "d.yaml", {"extends": "c.yaml", "robot": "hector"})
    for folder in (tmp_path, tmp_path / "mine"):
        monkeypatch.chdir(folder)
        names = [load_task(os.path.relpath(tmp_path / "mine" / f"{n}.yaml")).robot_config.name for n in "bcd"]
        assert names == ["first", "second", "hector"]
    assert Path(read_task(Path("b.yaml"))["robot"]).is_absolute()  # so that a run finds it


def test_a_robot_by_an_environment_variable_is_relative_to_the_file_that_names_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("OGMP_ROBOT", "robot")
    shutil.copytree(ROBOTS_DIR / "hector", tmp_path / "bases" / "robot")
    write(tmp_path / "bases" / "a.yaml", {"extends": "parkour", "robot": "${oc.env:OGMP_ROBOT}/robot.yaml"})
    path = write(tmp_path / "b.yaml", {"extends": "bases/a.yaml"})
    assert load_task(path).robot_config.path == tmp_path / "bases" / "robot" / "robot.yaml"
    monkeypatch.setenv("OGMP_ROBOT", str(tmp_path / "bases" / "robot"))
    assert load_task(path).robot_config.path == tmp_path / "bases" / "robot" / "robot.yaml"


# ---- merged ----


@pytest.mark.parametrize(
    ("extended", "own", "expected"),
    [
        ({"rho": 1}, {}, {"rho": 1}),
        ({"rho": 1}, {"rho": 2}, {"rho": 2}),
        ({"modes": {"jump": {"w": 1, "h": 2}}}, {"modes": {"jump": {"h": 3}}}, {"modes": {"jump": {"w": 1, "h": 3}}}),
        # a list replaces, whole
        ({"modes": {"pace": {"v": [1, 2]}}}, {"modes": {"pace": {"v": [3, 4]}}}, {"modes": {"pace": {"v": [3, 4]}}}),
        ({"sampling": {"sequence": ["pace", "jump"]}}, {"sampling": {"sequence": ["leap"]}},
         {"sampling": {"sequence": ["leap"]}}),
        ({"modes": {"pace": {"v": [1, 2]}}}, {"modes": {"pace": {"v": 3}}}, {"modes": {"pace": {"v": 3}}}),
        # a mapping over what is none replaces it
        ({"curriculum": None}, {"curriculum": {"step": 0.1}}, {"curriculum": {"step": 0.1}}),
        ({"modes": {"jump": None}}, {"modes": {"jump": {"w": 1}}}, {"modes": {"jump": {"w": 1}}}),
        # the bound is replaced whole; a mapping of that name elsewhere merges
        ({"bound": {"x": 1, "z": 1}}, {"bound": {"z": 2}}, {"bound": {"z": 2}}),
        ({"rewards": {"bound": {"x": 1}}}, {"rewards": {"bound": {"z": 2}}}, {"rewards": {"bound": {"x": 1, "z": 2}}}),
        # null is a value here
        ({"horizon": 30, "rho": 1, "curriculum": {"step": 1}}, {"horizon": None, "rho": None, "curriculum": None},
         {"horizon": None, "rho": None, "curriculum": None}),
        ({"modes": {"jump": {"w": 1}}}, {"modes": {"jump": None}}, {"modes": {"jump": None}}),
        ({"observations": {"clock": {}}}, {"observations": {"clock": None}}, {"observations": {"clock": None}}),
        ({"evaluation": {"terminations": {"fall": {}}}}, {"evaluation": {"terminations": {"fall": None}}},
         {"evaluation": {"terminations": {"fall": None}}}),
        ({"track": {"length": 3}}, {"track": {"length": None}}, {"track": {"length": None}}),
        ({"rewards": {"a": {"weight": 1}}}, {"rewards": {"a": {"weight": None}}}, {"rewards": {"a": {"weight": None}}}),
        # and here it is none, so it takes the key out
        ({"gait": {"cycle": 1}, "track": {"boxes": 3, "width": 1}}, {"gait": None, "track": {"boxes": None}},
         {"track": {"width": 1}}),
        ({"sampling": {"sequence": ["pace"], "weights": {"jump": 1, "pace": 1}}},
         {"sampling": {"sequence": None, "weights": {"jump": None}}}, {"sampling": {"weights": {"pace": 1}}}),
        ({"curriculum": {"modes": {"jump": {"h": 1}, "leap": {"w": 1, "d": 1}}, "step": 1}},
         {"curriculum": {"modes": {"jump": None, "leap": {"w": None}}, "step": None}},
         {"curriculum": {"modes": {"leap": {"d": 1}}}}),
        ({"modes": {"jump": {"w": 1, "v": 1}}}, {"modes": {"jump": {"v": None}}}, {"modes": {"jump": {"w": 1}}}),
        ({"oracle_params": {"lqr": {"eps": 1}, "linear": {}}}, {"oracle_params": {"lqr": None}},
         {"oracle_params": {"linear": {}}}),
        ({"evaluation": {"metrics": ["return"]}}, {"evaluation": {"metrics": None}}, {"evaluation": {}}),
        # what a task must have stays, for the check to name it, as does what is not there to take out
        ({"oracle": "lqr", "modes": {}}, {"oracle": None, "modes": None}, {"oracle": None, "modes": None}),
        ({"bound": {"x": 1}}, {"bound": None}, {"bound": None}),
        ({}, {"gait": None}, {"gait": None}),
        ({"gait": {"cycle": 1, "hight": 2}}, {"gait": {"hight": None}}, {"gait": {"cycle": 1, "hight": None}}),
    ],
)  # fmt: skip
def test_mappings_merge_and_everything_else_replaces(extended: Any, own: Any, expected: Any) -> None:
    before = copy.deepcopy((extended, own))
    assert merged(extended, own) == expected
    assert (extended, own) == before


def test_terms_stay_in_the_order_of_the_extended_file_and_new_ones_follow() -> None:
    extended = {"observations": {"proprioception": {}, "clock": {}, "height_scan": {"points": 3}}}
    own = {"observations": {"commanded_speed": {}, "height_scan": {"points": 5}, "clock": None}}
    assert list(merged(extended, own)["observations"]) == ["proprioception", "clock", "height_scan", "commanded_speed"]


def test_what_null_takes_out_has_its_default(tmp_path: Path) -> None:
    own = {"sampling": None, "gait": {"cycle": None}, "curriculum": {"weights": None, "modes": {"pace": None}}}
    task = load_task(write(tmp_path / "mine.yaml", {"extends": "parkour", **own, "modes": {"jump": {"run_up": None}}}))
    assert (task.sampling.weights, task.gait.cycle, task.gait.height) == ({}, 0.25, 0.55)
    assert task.curriculum is not None
    assert (task.curriculum.weights, list(task.curriculum.modes)) == ({}, ["jump", "leap"])
    assert list(task.modes["jump"] or ()) == ["w", "h", "v"]


def test_a_mode_comes_back_after_null(tmp_path: Path) -> None:
    write(tmp_path / "a.yaml", {"extends": "parkour", "modes": {"jump": None}})
    task = load_task(write(tmp_path / "b.yaml", {"extends": "a.yaml", "modes": {"jump": {"w": 0.4, "h": 0.1}}}))
    assert set(task.mode_ranges) == {"pace", "jump", "leap"} and set(task.mode_ranges["jump"]) == {"w", "h"}


# ---- mistakes ----


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("extends: parkuor", KeyError, "'extends': unknown task 'parkuor' (allowed: dive, dive_robot, parkour, "
         "parkour_robot, stairs). Did you mean 'parkour'? Or give the path of a YAML file."),
        ("extends: bsae.yaml", ValueError, "bsae.yaml: no such file. Did you mean 'base.yaml'?"),
        ("extends: elsewhere/base.yaml", ValueError, "elsewhere/base.yaml: no such file."),
        ("extends: .", KeyError, "'extends': unknown task '.'"),
        ("extends: ./", ValueError, "no such file."),
        ("extends:", TypeError, "'extends' must be text, found nothing (null)."),
        ("extends: 3", TypeError, "'extends' must be text, found the number 3."),
        ("extends: [dive, parkour]", TypeError, "'extends' must be text, found the list ['dive', 'parkour']."),
        ("extends: {task: dive}", TypeError, "'extends' must be text, found a mapping."),
        ("extend: dive", KeyError, "'extend' is not a known key (allowed: action, bound,"),
        ("extend: dive", KeyError, "Did you mean 'extends'?"),
        ("extends: dive\nextend: dive", KeyError, "'extend' is not a known key"),
        ("extends: dive\nrhoo: 3", KeyError, "'rhoo' is not a known key"),
        ("extends: mine.yaml", ValueError, "'extends' leads back to the same file: "),
    ],
)  # fmt: skip
def test_a_wrong_extends_is_one_sentence(tmp_path: Path, text: str, kind: type[Exception], message: str) -> None:
    write(tmp_path / "base.yaml", "extends: dive")
    path = write(tmp_path / "mine.yaml", text)
    found = sentence(kind, path)
    assert found.startswith(f"{path}: ") and message in found


def test_files_that_extend_each_other_are_named(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    a = write(tmp_path / "a.yaml", "extends: sub/b.yaml")
    b = write(tmp_path / "sub" / "b.yaml", "extends: ../sub/c.yaml")
    c = write(tmp_path / "sub" / "c.yaml", "extends: b.yaml")
    found = sentence(ValueError, a)
    assert found.startswith(f"{tmp_path}/sub/../sub/c.yaml: 'extends' leads back to the same file: {b} -> ")
    assert found.endswith(f"c.yaml -> {b}.") and c.is_file()


def test_an_extended_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    base = write(tmp_path / "base.yaml", "rho: [")
    assert sentence(ValueError, write(tmp_path / "mine.yaml", "extends: base.yaml")).startswith(f"{base}: not readable")


def test_a_scene_or_a_robot_is_no_task_to_extend(tmp_path: Path) -> None:
    scene = write(tmp_path / "scene.yaml", "description: x\nsequence: [pace]")
    path = write(tmp_path / "mine.yaml", "extends: scene.yaml")
    assert sentence(KeyError, path).startswith(f"{scene}: 'sequence' is not a known key (allowed: ")
    write(tmp_path / "mine.yaml", f"extends: {ROBOTS_DIR}/hector/robot.yaml")
    assert " is not a known key" in sentence(KeyError, path)


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("rho", -1, ValueError, "'rho' must be above 0"),
        ("modes.jump.h", "high", TypeError, "'modes.jump.h' must be a number"),
        ("modes.jmp", {"w": 1}, KeyError, "unknown mode 'jmp'"),
        ("rewards.body_contact.wieght", 1, KeyError, "has no parameter 'wieght'"),
        ("rhoo", 1, KeyError, "'rhoo' is not a known key"),
        ("modes.jump.w", MISSING, KeyError, "mode 'jump' needs the parameter 'w'"),
    ],
)
def test_a_mistake_names_the_file_that_has_it(
    key: str, value: Any, kind: type[Exception], message: str, tmp_path: Path
) -> None:
    base = write(tmp_path / "base.yaml", put(PARKOUR, key, value))
    write(tmp_path / "between.yaml", {"extends": "base.yaml", "horizon": 20})
    found = sentence(kind, write(tmp_path / "mine.yaml", {"extends": "between.yaml", "episode_steps": 20}))
    assert found.startswith(f"{base}: ") and message in found
    if value is not MISSING and "." not in key:
        own = write(tmp_path / "own.yaml", {"extends": "parkour", key: value})
        found = sentence(kind, own)
        assert found.startswith(str(own)) and message in found and found.count("own.yaml") == 1


def test_a_mistake_that_files_make_together_names_both(tmp_path: Path) -> None:
    path = write(tmp_path / "mine.yaml", {"extends": "parkour", "control_dt": 0.0301})
    assert sentence(ValueError, path).startswith(f"{path} (extends tasks/parkour.yaml): control_dt / physics_dt must")
    path = write(tmp_path / "mine.yaml", {"extends": "parkour", "sampling": {"order": "sequence"}})
    assert sentence(ValueError, path).startswith(f"{path} (extends tasks/parkour.yaml): 'sampling': order: sequence")


def test_a_key_that_no_file_gives_is_missing_in_the_one_that_is_loaded(tmp_path: Path) -> None:
    write(tmp_path / "base.yaml", {name: value for name, value in PARKOUR.items() if name not in ("rho", "oracle")})
    path = write(tmp_path / "mine.yaml", {"extends": "base.yaml", "rho": 0.5})
    assert sentence(KeyError, path).startswith(f"{path} (extends {tmp_path}/base.yaml): 'oracle' is missing")
    assert load_task(write(tmp_path / "whole.yaml", {"extends": "mine.yaml", "oracle": "lqr"})).oracle == "lqr"


def test_the_word_in_a_comment_changes_no_message(tmp_path: Path) -> None:
    path = write(tmp_path / "mine.yaml", "# extends parkour one day\nrho: 1\n")
    assert sentence(KeyError, path) == f"{path}: 'description' is missing: the file must give it."


# ---- the keys ----


def test_every_key_of_a_task_can_be_in_the_file(tmp_path: Path) -> None:
    assert set(PARKOUR) < set(KEYS) and "extends" in KEYS and not {"name", "file", "robot_config"} & set(KEYS)
    assert with_extended({"extends": "parkour"}, tmp_path / "any.yaml") == PARKOUR
