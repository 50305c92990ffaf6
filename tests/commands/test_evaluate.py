"""The command line of ogmp-eval: analyses by their keys, what they refuse, and the files they write."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from helpers.faults import read_only
from helpers.programs import program
from ogmp_sb3.commands import evaluate
from ogmp_sb3.commands.evaluate import ANALYSES, METRICS, EvalConfig, protocol_task, training_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.runs.policies import load_policy

ASKED = {"grid": "jump.w,jump.h", "robustness": True, "worst_case": True, "epsilon": True, "falls": True}


def test_every_analysis_is_asked_for_by_the_key_of_its_name() -> None:
    assert {analysis.name for analysis in ANALYSES} == set(ASKED) <= {field.name for field in fields(EvalConfig)}
    for analysis in ANALYSES:
        assert EvalConfig(run="parkour", **{analysis.name: ASKED[analysis.name]}).analysis is analysis
    assert EvalConfig(run="parkour").analysis is METRICS


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"episodes": 0}, "'episodes' must be at least 1, found 0"),
        ({"seed": -1}, "'seed' must be at least 0, found -1"),
        ({"max_distance": 0.0}, "'max_distance' must be above 0, found 0"),
        ({"max_distance": 50.0}, "'max_distance' is for 'protocol=endless' alone"),
        (
            {"grid": "jump.w,jump.h", "epsilon": True},
            "'grid' and 'epsilon' are different evaluations: give one of them",
        ),
        ({"grid": "jump.w,jump.h", "protocol": "endless"}, "'grid' plays the task's own protocol, not 'protocol=endl"),
        (
            {"worst_case": True, "disturbed": True},
            "'worst_case' disturbs the policy itself: leave 'disturbed=true' out",
        ),
        ({"epsilon": True, "protocol": "endless"}, "'epsilon' plays the task's own protocol, not 'protocol=endless'"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(keys: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        EvalConfig(run="parkour", **keys)


def test_robustness_decides_on_the_disturbances_of_the_test_and_uses_those_of_the_training() -> None:
    loaded, config = load_policy("parkour"), EvalConfig(run="parkour", robustness=True)
    with pytest.raises(ValueError, match="'robustness' disturbs one thing at a time; its ranges are 'randomisation'"):
        training_task(loaded, ["evaluation.randomisation.mass.scale=1.1"], config)
    assert training_task(loaded, ["randomisation.mass.scale=1.1"], config).randomisation is not None
    with pytest.raises(ValueError, match="randomisation"):
        training_task(loaded, ["randomisation.mass.scale=1.1"], EvalConfig(run="parkour"))


def test_a_test_may_have_the_disturbances_of_the_training() -> None:
    loaded, config = load_policy("parkour"), EvalConfig(run="parkour", disturbed=True)
    trained = training_task(loaded, ["randomisation.mass.scale=[0.8,1.2]"], config)
    assert protocol_task(trained, config).randomised == {"mass": {"scale": Range(0.8, 1.2)}}
    assert not protocol_task(trained, EvalConfig(run="parkour")).randomised
    with pytest.raises(ValueError, match="'disturbed=true': 'parkour' has no 'randomisation'; give some"):
        protocol_task(training_task(loaded, [], config), config)


def test_the_endless_protocol_has_neither_an_end_nor_a_share_of_the_time_and_is_not_for_timed_modes() -> None:
    config = EvalConfig(run="parkour", protocol="endless", max_distance=3.0)
    task = protocol_task(load_policy("parkour").task, config)
    assert task.track.length is None
    assert task.episode_steps * task.control_dt == pytest.approx(30.0, abs=task.control_dt)  # at 0.1 m/s
    assert "episode_length_fraction" not in task.evaluation.metrics
    with pytest.raises(ValueError, match="'protocol=endless' is for tracks: the modes of 'dive' take a time"):
        protocol_task(load_policy("dive").task, config)


def test_a_grid_writes_its_cells_and_a_picture_and_names_both(tmp_path: Path) -> None:
    grid = "grid=jump.w:0.2:0.4:2,jump.h:0.2:0.3:1"
    done = program("eval", "run=parkour", grid, "episodes=1", "evaluation.episode_steps=5", "out=out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "out/grid.png, out/grid.json\n"
    report = json.loads((tmp_path / "out" / "grid.json").read_text())
    assert [cell["w"] for cell in report["grid"]["cells"]] == [[0.2, 0.3], [0.3, 0.4]]
    assert report["grid"]["cells"][0]["metrics"]["return"]["n"] == 1
    assert (report["task"], report["protocol"], report["seed"]) == ("parkour", "paper", 0)


def test_a_grid_over_an_unknown_mode_is_one_sentence_and_writes_nothing(tmp_path: Path) -> None:
    done = program("eval", "run=parkour", "grid=jmp.w,jmp.h", "out=out", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "unknown mode 'jmp'" in done.stderr
    assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_saved_is_known_before_the_first_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def play(*_: object) -> None:
        raise AssertionError("plays")

    monkeypatch.setattr(evaluate, "METRICS", replace(METRICS, measure=play))
    (tmp_path / "file").touch()
    (tmp_path / "shared").mkdir()
    with read_only(tmp_path / "shared"):
        for out, reason in (("shared/new", "Permission denied"), ("file/new", "Not a directory")):
            done = program("eval", "run=parkour", f"out={tmp_path / out}", cwd=tmp_path)
            assert done.returncode == 2
            assert f"'{tmp_path / out}': nothing can be saved there (" in done.stderr
            assert f"{reason}). Give another directory: out=<directory>." in done.stderr
