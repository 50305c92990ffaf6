"""Task files: how they are found, and the one sentence that every mistake gets."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest

from helpers.mistakes import MISSING, MISTAKES, SHIPPED, put, sentence, write
from ogmp_sb3 import load_task
from ogmp_sb3.config.robot import INPUT_NAMES
from ogmp_sb3.config.task import TaskConfig

# ---- load_task: one mistake, one sentence ----


@pytest.mark.parametrize(("key", "value", "kind", "parts"), [(k, v, e, parts) for k, v, e, *parts in MISTAKES])
def test_a_mistake_is_one_sentence(
    tmp_path: Path, key: str, value: Any, kind: type[Exception], parts: list[str]
) -> None:
    message = sentence(kind, write(tmp_path, put(SHIPPED["parkour"], key, value)))
    for part in parts:
        assert part in message


def test_a_curriculum_cannot_move_a_word(tmp_path: Path) -> None:
    data = put(SHIPPED["dive"], "curriculum", {"modes": {"flip": {"r": "front"}}})
    message = sentence(ValueError, write(tmp_path, data))
    assert "'curriculum.modes.flip.r' is a word, which has no values between two levels" in message


def test_a_curriculum_moves_only_what_the_task_gives_a_value(tmp_path: Path) -> None:
    message = sentence(
        KeyError,
        write(
            tmp_path,
            put(SHIPPED["parkour"], "modes.leap.run_up", MISSING)
            | {"curriculum": {"modes": {"leap": {"run_up": 0.6}}}},
        ),
    )
    assert "'curriculum.modes.leap.run_up' needs 'modes.leap.run_up' too" in message


REQUIRED = [f.name for f in dataclasses.fields(TaskConfig) if f.default is f.default_factory is dataclasses.MISSING]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        *((key, f"'{key}' is missing") for key in REQUIRED),
        ("modes.jump.w", "'modes.jump': mode 'jump' needs the parameter 'w'"),
        ("modes.leap.d", "'modes.leap': mode 'leap' needs the parameter 'd'"),
        ("oracle_params", "'oracle_params.preview': oracle 'preview' needs the parameter 'Q'"),
        ("oracle_params.preview", "'oracle_params.preview': oracle 'preview' needs the parameter 'Q'"),
        ("oracle_params.lqr.R", "'oracle_params.lqr': oracle 'lqr' needs the parameter 'R'"),
        *((f"oracle_params.preview.R.{u}", f"'oracle_params.preview.R.{u}' is missing") for u in INPUT_NAMES),
        ("rewards.body_contact.weight", "'rewards.body_contact': reward 'body_contact' needs the parameter 'weight'"),
        ("terminations.fall.min_height", "termination 'fall' needs the parameter 'min_height'"),
        ("observations.height_scan.points", "observation 'height_scan' needs the parameter 'points'"),
        ("modes.pace", "'sampling.weights' has 'pace' (allowed: jump, leap)"),
    ],
)
def test_a_missing_key_is_named(tmp_path: Path, key: str, message: str) -> None:
    assert message in sentence(KeyError, write(tmp_path, put(SHIPPED["parkour"], key, MISSING)))


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("modes", {}, ValueError, "'modes' names no mode"),
        ("modes", {"pace": None}, ValueError, "'modes' names no mode"),
        ("bound", {}, ValueError, "'bound' gives every state the weight 0"),
        ("observations", {}, ValueError, "'observations' names no observation"),
        ("observations", {"clock": None}, ValueError, "'observations' names no observation"),
        ("sampling", {"weights": dict.fromkeys(("pace", "jump", "leap"), 0)}, ValueError, "every mode the weight 0"),
        ("oracle_params", {"preview": {"Q": {}, "R": {}, "eps": 1}}, KeyError, "preview.R.fx' is missing"),
    ],
)
def test_what_must_not_be_empty_is_named(tmp_path: Path, key: str, value: Any, kind: type[Exception], message: str):
    assert message in sentence(kind, write(tmp_path, put(SHIPPED["parkour"], key, value)))


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("", KeyError, "'description' is missing"),
        ("[1, 2]", ValueError, "expected a mapping at the top, found the list"),
        ("hello", KeyError, "'hello' is not a known key"),
        ("rho: [", ValueError, "not readable as YAML"),
        ("rho: 1\nrho: 2", ValueError, "found duplicate key rho"),
        ("rho: !!python/name:os.system", ValueError, "not readable as YAML"),
        ('"a\\nb": 1', KeyError, r"'a\nb' is not a known key"),
        ("1: 2", KeyError, "'1' is not a known key"),
    ],
)
def test_a_file_that_is_no_task_is_one_sentence(tmp_path: Path, text: str, kind: type[Exception], message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(kind, match=re.escape(message).replace(r"\\n", r"\\+n")) as caught:
        load_task(path)
    assert caught.value.args[0].startswith(f"{path}: ")
    assert "\n" not in caught.value.args[0]
