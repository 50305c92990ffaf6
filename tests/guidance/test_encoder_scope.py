"""What an encoder was trained on, against what tasks ask for."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.encoder_scope import TRAINED_ON, outside, scope
from ogmp_sb3.guidance.encoder_training import AutoEncoder, save_encoder
from ogmp_sb3.guidance.reference_data import reference_data


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By task: an encoder that says it was trained on it."""
    folder, model = tmp_path_factory.mktemp("encoders"), AutoEncoder(np.zeros(13), np.ones(13))
    for name in ("parkour", "dive"):
        save_encoder(model, folder / name, {TRAINED_ON: scope(load_task(name))})
    return {name: folder / name for name in ("parkour", "dive")}


def said(trained: dict[str, Path], name: str, **changes: Any) -> str | None:
    return outside(load_task(name, {"encoder": str(trained[name]), **changes}))


OUTSIDE = {
    "wider": ("parkour", {"modes.jump.h": [0.3, 0.45]}, "'modes.jump.h' was 0.02 to 0.35, and is 0.02 to 0.45 in"),
    "lower": ("parkour", {"modes.pace.v": 0.4}, "'modes.pace.v' was 0.6 to 1.8, and is 0.4 to 0.8 in this task"),
    "curriculum": ("parkour", {"curriculum.modes.jump.h": [0.0, 0.4]}, "'modes.jump.h' .* is 0 to 0.4 in this task"),
    "sequence": (
        "parkour",
        {"sampling": {"order": "sequence", "sequence": ["pace", {"leap": {"w": 0.5}}]}, "curriculum": None},
        "'modes.leap.w' was 0.05 to 0.35, and is 0.5 in this task$",
    ),
    "oracle": ("parkour", {"oracle": "lqr"}, "'oracle' was preview, and is lqr in this task$"),
    "weight": ("parkour", {"oracle_params.preview.Q.x": 2.0}, "'oracle_params.preview.Q.x' was 0, and is 2 in"),
    "horizon": ("parkour", {"horizon": 15}, "'horizon' was 30, and is 15 in this task$"),
    "two keys": (
        "parkour",
        {"horizon": 15, "gait.height": 0.5},
        r"'horizon' .* in this task \(gait.height differs too",
    ),
    "feedback": ("parkour", {"feedback": ["x", "z"]}, "'feedback' was vx, vy, vz, x, y, z, and is x, z in this task$"),
    "mode": ("dive", {"modes.pace": {"v": 1.0}, "modes.flip.h": 2.0}, "'modes.flip.h' was 1 to 1.75, and is 2 in"),
    "order": (
        "dive",
        {"sampling.sequence": ["flip"]},
        "'sampling' was flip, settle, then last, and is flip, then last",
    ),
}


@pytest.mark.parametrize("case", OUTSIDE)
def test_the_key_that_leaves_what_was_trained_is_named_with_both_values(case: str, trained: dict[str, Path]) -> None:
    name, changes, message = OUTSIDE[case]
    sentence = said(trained, name, **changes)
    assert sentence is not None
    assert re.search(f"tasks/{name}.yaml: the encoder '.*' was trained on other references: {message}", sentence)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("parkour", {}),
        ("dive", {}),
        ("parkour", {"modes.jump.h": [0.02, 0.08], "modes.leap.w": 0.1}),  # what the curriculum begins with
        ("parkour", {"modes.leap": None}),
        ("parkour", {"curriculum": None, "restarts": None}),
        ("parkour", {"sampling": {"order": "sequence", "sequence": ["pace", "jump"]}, "curriculum": None}),
        ("parkour", {"rho": 0.1, "bound": {"x": 1.0, "z": 1.0}, "track.width": 1.0, "observations.clock": None}),
        ("parkour", {"oracle_params.lqr.eps": 1e-3}),  # of an oracle that is not asked
        ("dive", {"modes.flip.r": "left", "modes.flip.h": 1.2}),
        ("parkour", {"observations.mode_latent": None, "horizon": 5}),
    ],
)
def test_what_was_drawn_in_the_training_is_inside(name: str, changes: dict[str, Any], trained: dict[str, Path]) -> None:
    assert said(trained, name, **changes) is None


def test_a_mode_that_was_not_trained_is_named_once(trained: dict[str, Path]) -> None:
    sentence = outside(load_task("parkour", {"encoder": str(trained["dive"])}))
    assert sentence is not None
    assert "'modes' was flip, settle, and is jump, leap, pace in this task (" in sentence
    assert "modes.jump" not in sentence and "gait.height" in sentence


def test_a_parameter_that_a_task_leaves_out_has_its_default() -> None:
    alone = {"modes.jump": None, "modes.leap": None, "curriculum": None}
    without = scope(load_task("stairs", {"modes.pace.length": 0.6, "modes.jump.run_up": 0.45}))
    assert without["modes.pace.length"] == [0.6, 0.6]
    assert scope(load_task("parkour", alone))["modes.pace.length"] == [0.4, 1.2]


def test_a_parameter_newer_than_an_encoder_was_its_default_then() -> None:
    """The shipped encoder knows no ``lead``: it was trained when that was a constant of 0.05 m."""
    found = outside(load_task("parkour", {"modes.jump.lead": 0.1}))
    assert found is not None and "'modes.jump.lead' was 0.05, and is 0.1 in this task" in found


def test_a_mode_of_weight_0_is_not_trained_on() -> None:
    assert scope(load_task("parkour", {"sampling.weights.leap": 0.0}))["modes"] == ["jump", "pace"]
    drawn_first = {"sampling.weights.leap": 0.0, "curriculum.weights.leap": 1.0}
    assert "leap" in scope(load_task("parkour", drawn_first))["modes"]


def test_everything_that_is_drawn_lies_in_the_scope() -> None:
    task = load_task("parkour")
    limits = scope(task)
    for call in reference_data(task, 100, np.random.SeedSequence(3)).calls:
        for key, value in call.parameters.items():
            low, high = limits[f"modes.{call.name}.{key}"]
            assert low <= value <= high


@pytest.mark.parametrize("name", ["parkour", "dive"])
def test_shipped_tasks_are_inside_their_encoders_and_encoders_of_before_say_nothing(name: str) -> None:
    assert load_task(name).encoder == name
    assert outside(load_task(name)) is None
    old = Path(__file__).parents[2] / "policies" / name / "encoder"
    assert TRAINED_ON not in json.loads((old / "encoder.json").read_text())
    assert outside(load_task(name, {"encoder": str(old), "oracle": "linear"})) is None
