"""Slowdowns are caught, and what is as it was passes. Times are of clocks that only move when they are told to."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco.batch import Batch

from ogmp_sb3.commands.bench import gate, program, timing
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.sb3.hyperparameters import default_ppo
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

SIM = partial(gate.sim_over_bare_physics, num_envs=2, steps=4, repeats=2)
CALLS = partial(gate.calls_per_step, num_envs=4, steps=4)
MEMORY = partial(gate.memory_kb_per_step, num_envs=4, steps=4)


class Costs:
    """Clocks on which each call of some functions takes a given time, and nothing else takes any."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._patch, self._now = patch, np.zeros(2)
        patch.setattr(timing, "_clocks", self._now.copy)

    def charge(self, kind: type[Any], name: str, cpu: float, asleep: float = 0.0) -> None:
        """Let each call of a method take so long, s."""
        method = getattr(kind, name)

        def charged(*args: Any, **kwargs: Any) -> Any:
            self._now += cpu, cpu + asleep
            return method(*args, **kwargs)

        self._patch.setattr(kind, name, charged)


@pytest.fixture
def costs(monkeypatch: pytest.MonkeyPatch) -> Costs:
    """A control step of physics takes 1 s, everything around it 0.25 s."""
    costs = Costs(monkeypatch)
    costs.charge(Batch, "step", cpu=1.0)
    costs.charge(OgmpVecEnv, "step_wait", cpu=0.25)
    return costs


def test_the_environment_s_own_share(costs: Costs) -> None:
    assert SIM() == pytest.approx(1 / 1.25)


def test_work_put_into_a_step_is_seen(costs: Costs) -> None:
    costs.charge(BatchEnv, "view", cpu=0.25)
    assert SIM() < 0.9 * (1 / 1.25)


def test_a_sleep_put_into_a_step_is_seen_though_it_takes_no_cpu(costs: Costs) -> None:
    costs.charge(OgmpVecEnv, "step_wait", cpu=0.0, asleep=0.25)
    assert SIM() == pytest.approx(1 / 1.5)


def test_a_whole_training_against_physics_of_two_milliseconds(costs: Costs, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = replace(default_ppo(), n_steps=8, batch_size=16, n_epochs=1)
    monkeypatch.setattr(gate, "default_ppo", lambda: recipe)
    costs.charge(RecurrentPPO, "train", cpu=6.0)
    # Eight control steps of 1.25 s and an update of 6 s, against eight of physics alone.
    assert gate.training_over_bare_physics(num_envs=2, repeats=1) == pytest.approx(8 / 16)


def test_the_update_against_bare_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = replace(default_ppo(), n_steps=8, batch_size=16, n_epochs=3)
    monkeypatch.setattr(gate, "default_ppo", lambda: recipe)
    costs = Costs(monkeypatch)
    costs.charge(gate.nn.LSTM, "forward", cpu=1.0)
    ratio = gate.learner_over_bare_lstm(num_envs=4, repeats=1)
    # Only calls of LSTMs take time here: bare ones one for each minibatch and network, ours at least as many.
    assert 0 < ratio <= 1
    costs.charge(RecurrentPPO, "train", cpu=12.0)
    calls = 2 * 3 * 2 / ratio  # two networks, three epochs, two minibatches
    assert gate.learner_over_bare_lstm(num_envs=4, repeats=1) == pytest.approx(12 / (calls + 12), rel=0.3)


def test_calls_are_counted_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    before = CALLS()
    assert CALLS() == before
    step = BatchEnv.step

    def with_work(env: BatchEnv, *args: Any) -> Any:
        for value in range(100):
            abs(value)
        return step(env, *args)

    monkeypatch.setattr(BatchEnv, "step", with_work)
    # A hundred times abs(), and the function around it.
    assert CALLS() == pytest.approx(before + 101)


def test_a_copy_that_a_step_holds_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    before = MEMORY()
    step = BatchEnv.step

    def with_copy(env: BatchEnv, *args: Any) -> Any:
        copy = np.ones(128 * 100)  # 100 KB
        result = step(env, *args)
        assert copy.all()
        return result

    monkeypatch.setattr(BatchEnv, "step", with_copy)
    assert MEMORY() == pytest.approx(before + 100, rel=0.1)


def measured(patch: pytest.MonkeyPatch, **values: list[float]) -> None:
    """The gate takes these measures, and gets these values one after another."""
    takes = {name: iter(results) for name, results in values.items()}
    table = {name: (partial(next, take), gate.MEASURES[name][1]) for name, take in takes.items()}
    patch.setattr(gate, "MEASURES", table)


def test_limits_are_on_the_side_where_a_measure_is_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    measured(monkeypatch, sim_over_bare_physics=[0.81], calls_per_step=[1090.0])
    ratio, calls = gate.compare({"sim_over_bare_physics": 0.9, "calls_per_step": 1000.0}, 0.10)
    assert (ratio.allowed, calls.allowed) == ("at least 0.810", "at most 1,100")
    assert ratio.passes and calls.passes


def test_better_than_the_baseline_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    measured(monkeypatch, sim_over_bare_physics=[5.0], calls_per_step=[1.0])
    assert all(row.passes for row in gate.compare({"sim_over_bare_physics": 0.9, "calls_per_step": 1000.0}, 0.10))


def test_a_measure_that_falls_short_is_taken_again_and_the_best_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    measured(monkeypatch, sim_over_bare_physics=[0.5, 0.7, 0.6], calls_per_step=[1200.0, 1050.0])
    ratio, calls = gate.compare({"sim_over_bare_physics": 0.9, "calls_per_step": 1000.0}, 0.10)
    assert (ratio.now, ratio.passes) == (0.7, False)
    assert (calls.now, calls.passes) == (1050.0, True)


def baseline(file: Path, **changes: Any) -> dict[str, Any]:
    """Write a baseline of this machine."""
    report = {"numbers": dict.fromkeys(gate.MEASURES, 1.0), "cpu": gate.cpu(), "versions": gate.versions(), **changes}
    file.write_text(json.dumps(report))
    return report


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """``ogmp-bench``, with all measures at 1 unless told otherwise."""

    def run(*arguments: str, **values: float) -> None:
        measured(monkeypatch, **{name: [values.get(name, 1.0)] * gate.TRIES for name in gate.MEASURES})
        program._run(list(arguments))

    return run


def test_a_copy_of_the_baseline_passes(
    run: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("gate", f"json={tmp_path / 'gate.json'}")
    report = json.loads((tmp_path / "gate.json").read_text())
    assert report["numbers"] == dict.fromkeys(gate.MEASURES, 1.0) and report["cpu"] == gate.cpu()
    run("gate", f"baseline={tmp_path / 'gate.json'}")
    *_, last = capsys.readouterr().out.strip().split("ogmp-bench gate")
    assert "at least 0.900" in last and "at most 1.100" in last and "elsewhere" not in last


def test_what_has_become_slower_fails_with_what_is_allowed(
    run: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline(tmp_path / "gate.json")
    with pytest.raises(SystemExit) as ended:
        run("gate", f"baseline={tmp_path / 'gate.json'}", sim_over_bare_physics=0.89, calls_per_step=1.2)
    assert ended.value.code == 1
    assert capsys.readouterr().err.splitlines() == [
        "ogmp-bench: sim_over_bare_physics is 0.890, at least 0.900 is allowed.",
        "ogmp-bench: calls_per_step is 1.200, at most 1.100 is allowed.",
        f"ogmp-bench: if that is meant, make the baseline anew: ogmp-bench gate json={tmp_path / 'gate.json'}",
    ]


def test_a_baseline_from_elsewhere_allows_more_and_says_so(
    run: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline(tmp_path / "gate.json", cpu="another", versions={**gate.versions(), "numpy": "1.0", "ogmp_sb3": "0"})
    run("gate", f"baseline={tmp_path / 'gate.json'}", sim_over_bare_physics=0.76)
    out = capsys.readouterr().out
    assert "at least 0.750" in out
    assert f"25% are allowed, as {tmp_path / 'gate.json'} is from elsewhere: cpu another, numpy 1.0." in out


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"numbers": {"sim_over_bare_physics": 0.9}}, "'numbers' must be those of a gate .*make it anew"),
        ({"numbers": dict.fromkeys(gate.MEASURES, 0.0)}, "each above 0"),
        ({"numbers": dict.fromkeys(gate.MEASURES, "fast")}, "numbers"),
        ({"numbers": None}, "numbers"),
        ({"versions": 3}, "versions"),
    ],
)
def test_what_is_no_baseline_is_refused(changes: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    baseline(tmp_path / "gate.json", **changes)
    with pytest.raises((ValueError, TypeError), match=f"{tmp_path / 'gate.json'}.*{sentence}"):
        gate.read_baseline(tmp_path / "gate.json")


def test_a_missing_baseline_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.json: not readable"):
        gate.read_baseline(tmp_path / "none.json")


def test_the_committed_baseline_can_be_read() -> None:
    numbers, _ = gate.read_baseline(Path(__file__).parents[3] / "benchmarks" / "gate.json")
    assert all(0 < numbers[name] < 1.1 for name, (_, more_is_better) in gate.MEASURES.items() if more_is_better)
