"""Everything that docs/paper-to-code.md names exists, and its commands are understood."""

from __future__ import annotations

import importlib
import inspect
import re
import shlex
from types import ModuleType
from typing import Any

import pytest
from hydra import compose, initialize_config_module

from helpers.paths import ROOT
from helpers.programs import script
from ogmp_sb3.commands import cli
from ogmp_sb3.commands.train import program as train
from ogmp_sb3.commands.train.search import VALUES
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.evaluation.grid import read_grid

TEXT = (ROOT / "docs" / "paper-to-code.md").read_text(encoding="utf-8")
ROLES = sorted(set(re.findall(r"\{py:(\w+)\}`~?([\w.]+)`", TEXT)))
NAMES = sorted(set(re.findall(r"(?<!\})`(ogmp_sb3(?:\.\w+)+)`", TEXT)))
FILES = sorted(set(re.findall(r"`((?:benchmarks|tasks|ogmp_sb3)/[\w./-]+)`", TEXT)))
COMMANDS = sorted(set(re.findall(r"`(ogmp-[a-z]+ [^`]+)`", TEXT)))
SECTIONS = sorted(set(re.findall(r"`(benchmarks/[\w.]+)`, section \*([^*]+)\*", TEXT)))
KINDS = {"mod": inspect.ismodule, "class": inspect.isclass, "func": inspect.isfunction, "meth": inspect.isfunction}


def named(name: str) -> Any:
    """The object of a dotted name."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            found = getattr(found, part)
        return found
    raise AssertionError(f"no module in {name}")


def module_of(program: str) -> ModuleType:
    return importlib.import_module(script(program))


@pytest.mark.parametrize(("kind", "name"), ROLES)
def test_a_cross_reference_has_a_target_with_documentation(kind: str, name: str) -> None:
    found = named(name)
    assert KINDS[kind](found)
    assert found.__doc__
    module = found.__name__ if kind == "mod" else found.__module__
    assert f".. automodule:: {module}\n" in (ROOT / "docs" / "api.rst").read_text(encoding="utf-8")


def test_the_page_names_parts_of_every_kind() -> None:
    assert {kind for kind, _ in ROLES} == set(KINDS)
    assert len(ROLES) > 40 and len(NAMES) > 5 and len(FILES) > 3 and len(COMMANDS) > 20 and len(SECTIONS) > 1


@pytest.mark.parametrize("name", NAMES)
def test_a_name_exists(name: str) -> None:
    assert named(name) is not None


@pytest.mark.parametrize("file", FILES)
def test_a_file_exists(file: str) -> None:
    assert (ROOT / file).is_file()


@pytest.mark.parametrize(("file", "title"), SECTIONS)
def test_a_section_exists(file: str, title: str) -> None:
    assert re.search(rf"^## {re.escape(title)}(:|$)", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("command", [command for command in COMMANDS if not command.startswith("ogmp-train ")])
def test_a_command_has_keys_and_values_that_its_program_and_task_know(command: str) -> None:
    program, *arguments = shlex.split(re.sub("<.*?>", "dive", command) if "<your dive run>" in command else command)
    module = module_of(program)
    if program == "ogmp-check":
        arguments = [argument if "=" in argument else f"task={argument}" for argument in arguments]
    (kind,) = (found for name, found in vars(module).items() if name == f"{program[5:].capitalize()}Config")
    config, overrides = cli.parse(kind, arguments, program, cli.task_keys(TaskConfig))
    task = "dive" if "dive" in command else "parkour"
    path = TASKS_DIR / f"{task}.yaml"
    loaded = task_for_test(read_yaml(path), path, overrides, getattr(config, "scene", None), program)
    if getattr(config, "grid", None):
        assert read_grid(config.grid, loaded, loaded).cells


@pytest.mark.parametrize("command", [command for command in COMMANDS if command.startswith("ogmp-train ")])
def test_a_training_composes_and_writes_where_its_report_reads(command: str) -> None:
    arguments = [argument for argument in shlex.split(command)[1:] if argument != "-m"]
    searches = [argument.removeprefix("+search=") for argument in arguments if argument.startswith("+search=")]
    assert set(searches) <= set(VALUES)
    single = [argument.partition(",")[0] for argument in arguments if not argument.startswith("+search=")]
    overrides, _ = train.register_tasks(single)
    with initialize_config_module("ogmp_sb3.conf", version_base="1.3"):
        config = compose("train", [*overrides, "hydra/launcher=basic"], return_hydra_config=True)
    if "+experiment=" in command and "+experiment=paper/" not in command:
        assert config.hydra.sweeper.params
        assert f"ogmp-report sweep={config.hydra.sweep.dir}" in TEXT


def test_no_command_writes_over_the_files_of_another() -> None:
    places: dict[tuple[str, str, str], list[str]] = {}
    for command in (c for c in COMMANDS if not c.startswith("ogmp-train ")):
        program, *arguments = shlex.split(command)
        given = dict(argument.partition("=")[::2] for argument in arguments)
        kind = next((name for name in ("grid", "robustness", "epsilon") if name in given), "")  # names the files
        place = next((given[key] for key in ("out", "video", "run", "sweep") if key in given), command)
        places.setdefault((program, place, kind), []).append(command)
    assert [commands for commands in places.values() if len(commands) > 1] == []
