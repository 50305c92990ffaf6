"""Properties: whatever is wrong in a task file or on a command line, it works or ends in one clear sentence.

``HYPOTHESIS_PROFILE=thorough`` tries some thousands of inputs in place of a few hundred.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from helpers.mutations import (
    JUNK,
    KEYS,
    KNOWN,
    PATHS,
    SHIPPED,
    check_sentence,
    edited,
    mangled,
    misspelt,
    mutated,
    parent,
    renumbered,
    works_or_says_why,
)
from helpers.programs import SMALL, program
from ogmp_sb3 import load_task
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.env.batch_env import BatchEnv

FEWER = settings(max_examples=max(settings().max_examples // 4, 1))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mistakes") / "mine.yaml"


def error_of(path: Path | str, overrides: Any = ()) -> str:
    with pytest.raises(KeyError) as caught:
        load_task(path, overrides)
    check_sentence(caught.value.args[0])
    return str(caught.value.args[0])


# ---- the task file ----


@given(data=mutated())
def test_a_mutated_task_works_or_ends_in_one_sentence(file: Path, data: dict[str, Any]) -> None:
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    works_or_says_why(file)


@given(content=mangled())
def test_a_mangled_file_works_or_ends_in_one_sentence(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    works_or_says_why(file)


@given(content=st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")))
def test_a_file_that_is_anything_ends_in_one_sentence(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    assert works_or_says_why(file) is None


@given(mistake=misspelt())
def test_no_misspelt_key_is_ever_accepted(file: Path, mistake: tuple[dict[str, Any], str]) -> None:
    task, wrong = mistake
    file.write_text(yaml.safe_dump(task, sort_keys=False))
    assert wrong in error_of(file)


@given(mistake=misspelt(keep=True))
def test_a_key_beside_the_right_ones_is_never_accepted(file: Path, mistake: tuple[dict[str, Any], str]) -> None:
    task, wrong = mistake
    file.write_text(yaml.safe_dump(task, sort_keys=False))
    assert wrong in error_of(file)


@given(data=st.data())
def test_a_key_given_twice_is_never_accepted(file: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(SHIPPED)))
    path = data.draw(st.sampled_from(KEYS[name]))
    lines = yaml.safe_dump(SHIPPED[name], sort_keys=False, default_flow_style=False).splitlines()
    indent = 2 * (len(path) - 1)
    at = [i for i, line in enumerate(lines) if line.startswith(f"{' ' * indent}{path[-1]}:")]
    assume(at and "&" not in lines[at[0]])
    lines.insert(at[0], f"{' ' * indent}{path[-1]}: 1")
    file.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=f"found duplicate key {path[-1]}"):
        load_task(file)


# ---- overrides ----


@given(data=st.data())
def test_a_misspelt_override_is_never_accepted(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(SHIPPED)))
    path = data.draw(st.sampled_from(KEYS[name]))
    at = data.draw(st.integers(0, len(path) - 1).filter(lambda i: isinstance(path[i], str)))
    wrong = data.draw(edited(path[at]))
    assume(wrong not in KNOWN and wrong and all(isinstance(key, str) for key in path))
    value = parent(SHIPPED[name], path)[path[-1]]
    assert wrong in error_of(name, {".".join([*path[:at], wrong, *path[at + 1 :]]): value})


@given(data=st.data())
def test_an_override_of_any_key_by_any_text_works_or_ends_in_one_sentence(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(SHIPPED)))
    keys = st.sampled_from([".".join(map(str, path)) for path in PATHS[name]])
    key = data.draw(keys | st.tuples(keys, st.text(max_size=3)).map(".".join) | st.text(max_size=6))
    if data.draw(st.booleans()):
        works_or_says_why(name, [f"{key}={data.draw(st.text(max_size=12))}"])
    else:
        works_or_says_why(name, {key: data.draw(JUNK)})


# ---- environments ----


@FEWER
@given(data=renumbered(), seed=st.integers(0, 2**32))
def test_an_environment_of_whatever_loads_is_finite_or_says_why(data: dict[str, Any], seed: int) -> None:
    try:
        task = task_from_data(data, Path("mine.yaml"))
        env = BatchEnv(task, num_envs=2, seed=seed, threads=1)
        rng = np.random.default_rng(0)
        for _ in range(4):
            result = env.step(rng.uniform(-1.0, 1.0, (2, env.action_size)))
            assert np.isfinite(result.observation).all()
            assert np.isfinite(result.reward).all()
            ended = np.flatnonzero(result.termination != "")
            if len(ended):
                env.reset(ended)
    except (ValueError, KeyError, TypeError) as error:
        check_sentence(error.args[0])


# ---- command lines ----


class Accepted(BaseException):
    """Everything was read, and the work began."""


@pytest.fixture(scope="module")
def door(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Programs stop where their work begins: with the first control step, or the first references of an encoder."""

    def begin(*_: Any, **__: Any) -> None:
        raise Accepted

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BatchEnv, "step", begin)
        patch.setattr("ogmp_sb3.commands.encode.reference_data", begin)
        patch.setattr("ogmp_sb3.commands.export.bundle.export", begin)
        patch.setattr("ogmp_sb3.commands.play.Viewer.run", begin)
        patch.setattr("ogmp_sb3.commands.bench.program.bench_physics", begin)
        patch.setattr("ogmp_sb3.report.run_sections.overview", begin)
        yield tmp_path_factory.mktemp("door")


RIGHT = {
    "train": ["task=dive", "rho=0.3", "seed=1", "total_timesteps=64", "task.modes.flip.h=[1.0,1.2]", "ppo.gamma=0.9",
              "hydra.run.dir=run", *SMALL],
    "eval": ["run=parkour", "episodes=3", "seed=1", "protocol=endless", "max_distance=5", "scene=faster",
                 "oracle=lqr", "out=out"],
    "play": ["task=dive", "seed=1", "port=0", "seconds=1.0", "rho=0.3"],
    "encode": ["task=dive", "references=3", "updates=3", "seed=1", "out=out"],
    "export": ["run=parkour", "out=exported"],
    "report": ["run=parkour", "episodes=2", "grids=false", "grid_cells=3", "traces=1", "variants=oracle", "out=out"],
    "bench": ["what=sim", "task=dive", "num_envs=2", "steps=2", "repeats=1"],
    "check": ["task=dive", "rho=0.2", "modes.flip.h=1.5"],
}  # fmt: skip
TOKENS = [
    "",
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e400",
    "1e-300",
    "null",
    "true",
    "[",
    "[1,2]",
    "{a: 1}",
    "a: b: c",
    "x",
]
TOKENS += [
    "1,2",
    "9" * 5000,
    "!!bool x",
    "!!python/name:os.system",
    "${rho}",
    "${",
    "*",
    "'",
    '"',
    "\n",
    "é",
    "=",
    "2**3",
]
TOKENS += ["2026-01-31", "nowhere.yaml", "/", "[" * 2000, "~", "choice(1,2)", "range(1,3)", "0x1F", "1_000"]


def ends_well(name: str, arguments: list[str], folder: Path) -> None:
    """A program either begins its work, or ends, and then a failure is one line and exit code 2."""
    try:
        done = program(name, *arguments, cwd=folder)
    except Accepted:
        return
    assert "Traceback" not in done.stderr
    if done.returncode:
        assert done.returncode == 2
        assert done.stderr.startswith("ogmp-")
        check_sentence(done.stderr.removesuffix("\n"))


@pytest.mark.parametrize("name", RIGHT)
def test_the_command_lines_to_be_mutated_are_right(name: str, door: Path) -> None:
    try:
        done = program(name, *RIGHT[name], cwd=door)
    except Accepted:
        return
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", RIGHT)
@FEWER
@given(data=st.data())
def test_a_mutated_command_line_works_or_ends_in_one_sentence(name: str, door: Path, data: st.DataObject) -> None:
    arguments = list(RIGHT[name])
    for _ in range(data.draw(st.integers(1, 2))):
        i = data.draw(st.integers(0, len(arguments) - 1))
        key, _, value = arguments[i].partition("=")
        match data.draw(st.sampled_from(["value", "key", "drop", "junk", "below", "prefix"])):
            case "value":
                arguments[i] = f"{key}={data.draw(st.sampled_from(TOKENS) | st.text(max_size=6))}"
            case "key":
                arguments[i] = f"{data.draw(edited(key)) if key else 'x'}={value}"
            case "drop" if len(arguments) > 1:
                del arguments[i]
            case "junk":
                arguments.insert(i, data.draw(st.sampled_from([*TOKENS, "--foo", "-x"]) | st.text(max_size=8)))
            case "below":
                arguments[i] = f"{key}.{data.draw(st.sampled_from(['x', '', '0', 'rho']))}={value}"
            case "prefix":
                arguments[i] = data.draw(st.sampled_from(["+", "++", "~", "task.", "@"])) + arguments[i]
    helps = {"-h", "--help", "help", "--hydra-help", "--version", "-m"}
    assume(not helps & set(arguments))
    ends_well(name, arguments, door)


@pytest.mark.parametrize("name", [name for name in RIGHT if name != "train"])
@given(data=st.data())
@FEWER
def test_a_misspelt_key_of_a_program_is_never_accepted(name: str, door: Path, data: st.DataObject) -> None:
    arguments = list(RIGHT[name])
    i = data.draw(st.integers(0, len(arguments) - 1))
    key, _, value = arguments[i].partition("=")
    wrong = data.draw(edited(key))
    assume(wrong != key and wrong.removeprefix("task.") not in KNOWN and "." not in wrong)
    arguments[i] = f"{wrong}={value}"
    done = program(name, *arguments, cwd=door)
    assert done.returncode == 2
    assert f"unknown key '{wrong}'" in done.stderr


@given(data=st.data())
@FEWER
def test_a_misspelt_key_of_a_training_is_never_accepted(door: Path, data: st.DataObject) -> None:
    key = data.draw(st.sampled_from([argument.partition("=")[0] for argument in RIGHT["train"]]))
    assume(not key.startswith("hydra."))
    wrong = data.draw(edited(key))
    assume(wrong != key and wrong.isidentifier() and wrong.rpartition(".")[2] not in KNOWN)
    done = program(
        "train", *(a.replace(key, wrong, 1) if a.startswith(f"{key}=") else a for a in RIGHT["train"]), cwd=door
    )
    assert done.returncode == 2
    assert wrong.rpartition(".")[2] in done.stderr
