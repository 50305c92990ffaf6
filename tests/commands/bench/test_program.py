"""The comparisons must compare like with like; how fast things are is no test."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from helpers.programs import program
from ogmp_sb3.commands.bench import program as bench
from ogmp_sb3.sb3.hyperparameters import default_ppo


@pytest.mark.parametrize(
    ("what", "key", "value", "sentence"),
    [
        ("learner", "run", "parkour", "'run' is for 'train', 'scaling' and 'physics', not for 'learner'"),
        ("learner", "steps", 10, "'steps' is for 'sim' and 'train', not for 'learner'"),
        ("sim", "stock", False, "'stock' is for 'train' alone, not for 'sim'"),
        ("train", "peer", "rsl_rl", "'peer' is for 'learner' alone, not for 'train'"),
        ("sim", "baseline", "gate.json", "'baseline' is for 'gate' alone, not for 'sim'"),
        ("gate", "repeats", 2, "'repeats' is for 'sim', 'learner', 'train', 'scaling' and 'physics', not for 'gate'"),
        ("gate", "task", "dive", "'task' is for .*, not for 'gate'"),
    ],
)
def test_what_a_benchmark_does_not_use_is_refused(what: Any, key: str, value: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        bench.BenchConfig(what=what, **{key: value})


def test_only_what_trains_takes_a_recipe_and_only_a_sound_one() -> None:
    with pytest.raises(ValueError, match="keys of ppo are for 'learner', 'train' and 'scaling', not for 'sim'"):
        bench._run(["sim", "ppo.n_epochs=2"])
    with pytest.raises(KeyError, match="Did you mean 'n_epochs'"):
        bench._run(["train", "ppo.n_epoch=2"])
    with pytest.raises(ValueError, match="'gamma' must be at most 1, found 2"):
        bench._run(["train", "ppo.gamma=2"])


def test_the_gate_takes_no_overrides_and_makes_a_baseline_or_compares_with_one() -> None:
    with pytest.raises(ValueError, match="the gate always measures the same task, found 'modes"):
        bench._run(["gate", "modes.jump=null"])
    with pytest.raises(ValueError, match="'baseline' compares with a file and 'json' makes one"):
        bench.BenchConfig(what="gate", baseline="gate.json", json="gate.json")


def test_a_training_is_of_the_policy_that_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = []
    monkeypatch.setattr(bench, "bench_train", lambda *arguments: given.append(arguments) or {"samples_per_second": 1.0})
    bench._run(["train", "run=parkour", "rho=0.3", "stock=false", "repeats=2"])
    bench._run(["train", "num_envs=8", "steps=100", "ppo.n_epochs=2", "ppo.input_layers=[8]"])
    (task, *numbers, recipe, policy, stock), (_, *others, changed, no_policy, with_stock) = given
    assert recipe == default_ppo() and changed == replace(recipe, n_epochs=2, input_layers=(8,))
    assert task.rho == 0.3 and numbers == [64, 0, 2] and policy.lstm_actor.num_layers and not stock
    assert others == [8, 100, 5] and no_policy is None and with_stock
    titles = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ogmp-bench")]
    assert "train, parkour, policy parkour" in titles[0] and "train, parkour, untrained" in titles[1]


def test_numbers_are_kept_with_what_they_are_of(tmp_path: Path) -> None:
    arguments = ["steps=10", "repeats=1", "num_envs=4", "modes.jump=null", "json=out/sim.json"]
    done = program("bench", "sim", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "sim.json").read_text())
    assert report["overrides"] == ["modes.jump=null"] and report["config"]["steps"] == 10
    assert 0 < report["numbers"]["sim_over_bare_physics"] < 1.5
    assert (tmp_path / "out" / "sim.png").is_file()
    assert "sim_over_bare_physics" in done.stdout
