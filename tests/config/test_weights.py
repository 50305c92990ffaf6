"""Parameters that are checked by their annotation, those of a plug-in's functions too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from helpers.mistakes import SHIPPED, put, sentence, write
from ogmp_sb3 import load_task
from ogmp_sb3.config import registry
from ogmp_sb3.config.editor_schema import task_schema
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.robot import INPUT_NAMES, STATE_NAMES
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.weights import InputWeights, Positive, StateWeights, TrackingWeights

EVERY_INPUT = dict.fromkeys(INPUT_NAMES, 1)


def track(
    set_points,
    x0,
    plant,
    states: StateWeights,
    inputs: InputWeights,
    delay: Positive = 0.1,
    phases: TrackingWeights | None = None,
): ...


@pytest.fixture
def oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    """An oracle that is not ours, with parameters of other names than ours have."""
    monkeypatch.setitem(registry.oracles._functions, "track", track)


def test_checked_values_are_plain(oracle: None, tmp_path: Path) -> None:
    parameters = {"states": {"x": 0}, "inputs": EVERY_INPUT, "delay": 1}
    task = load_task(write(tmp_path, put(SHIPPED["parkour"], "oracle_params.track", parameters)))
    assert task.oracle_params["track"] == parameters
    assert {type(value) for value in task.oracle_params["track"].values()} == {dict, float}


def test_weights_are_the_same_in_both_phases_of_contact_or_given_for_each(oracle: None, tmp_path: Path) -> None:
    def read_phases(data: dict[str, Any]) -> Any:
        parameters = {"states": {}, "inputs": EVERY_INPUT, "phases": data}
        return load_task(write(tmp_path, put(SHIPPED["parkour"], "oracle_params.track", parameters))).oracle_params

    assert read_phases({"z": 3})["track"]["phases"] == {"z": 3.0}
    found = read_phases({"stance": {"z": 3}, "flight": {}})["track"]["phases"]
    assert found == {"stance": {"z": 3.0}, "flight": {}}
    assert type(found["stance"]["z"]) is float


def test_one_weight_of_one_phase_is_changed_from_the_command_line() -> None:
    Q = load_task("dive", ["oracle_params.preview.Q.flight.vz=7"]).oracle_params["preview"]["Q"]
    assert (Q["flight"]["vz"], Q["stance"]["vz"]) == (7.0, 1000.0)


@pytest.mark.parametrize(
    ("key", "value", "kind", "message"),
    [
        ("phases", {"stance": {}}, KeyError, "track.phases.flight' is missing"),
        ("phases", {"stance": {}, "fligt": {}}, KeyError, "stance). Did you mean 'flight'?"),
        ("phases", {"stance": {}, "flight": {}, "z": 1}, KeyError, "phases.z' is not a known key (allowed: flight, "),
        ("phases", {"stance": {}, "flight": {"zz": 1}}, KeyError, "phases.flight' has 'zz'"),
        ("phases", {"stance": {"z": -1}, "flight": {}}, ValueError, "phases.stance.z' must be at least 0, found -1."),
        ("phases", {"stance": 1, "flight": {}}, TypeError, "phases.stance' must be a mapping"),
        ("phases", {"stanc": {"z": 1}}, KeyError, "phases.stanc' is not a known key"),
        ("states", {"rol": 1}, KeyError, "track.states' has 'rol' (allowed: "),
        ("states", {"x": -1}, ValueError, "track.states.x' must be at least 0, found -1."),
        ("states", 3, TypeError, "track.states' must be a mapping"),
        ("inputs", {"fw": 1}, KeyError, "track.inputs' has 'fw' (allowed: fx, fy, fz, mx, my, mz)."),
        ("inputs", {"fx": 1}, KeyError, "track.inputs.fy' is missing: every input needs a weight."),
        ("inputs", {**EVERY_INPUT, "mx": 0}, ValueError, "track.inputs.mx' must be above 0, found 0."),
        ("delay", 0, ValueError, "track.delay' must be above 0, found 0."),
        ("delay", "long", TypeError, "track.delay' must be a number"),
    ],
)
def test_a_mistake_in_a_checked_parameter_is_one_sentence(
    oracle: None, tmp_path: Path, key: str, value: Any, kind: type[Exception], message: str
) -> None:
    parameters = {"states": {}, "inputs": EVERY_INPUT, key: value}
    assert message in sentence(kind, write(tmp_path, put(SHIPPED["parkour"], "oracle_params.track", parameters)))


def test_a_checked_type_may_be_null_or_inside_another() -> None:
    assert read(Positive | None, None, Where("file")) is None  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="file: 'b' must be above 0, found -2"):
        read(dict[str, Positive], {"a": 1, "b": -2}, Where("file"))


def test_an_editor_knows_the_names_of_weights(oracle: None) -> None:
    parameters = task_schema()["else"]["properties"]["oracle_params"]["properties"]["track"]["properties"]
    assert list(parameters["states"]["properties"]) == list(STATE_NAMES)
    assert list(parameters["inputs"]["properties"]) == list(INPUT_NAMES)
    assert parameters["delay"]["type"] == "number"
    same, each, _ = parameters["phases"]["anyOf"]
    assert list(same["properties"]) == list(each["properties"]["flight"]["properties"]) == list(STATE_NAMES)
    assert each["required"] == ["flight", "stance"]
