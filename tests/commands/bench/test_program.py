"""The comparisons must compare like with like; how fast things are is no test."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from helpers.programs import program
from ogmp_sb3.commands.bench import program as bench


def test_what_a_benchmark_does_not_use_is_refused() -> None:
    with pytest.raises(ValueError, match="'run' is for 'physics' alone, not for 'train'"):
        bench.BenchConfig(what="train", run="parkour")
    with pytest.raises(ValueError, match="'steps' is for 'sim' and 'train', not for 'learner'"):
        bench.BenchConfig(what="learner", steps=10)


def test_numbers_are_kept_with_what_they_are_of(tmp_path: Path) -> None:
    arguments = ["steps=10", "repeats=1", "num_envs=4", "modes.jump=null", "json=out/sim.json"]
    done = program("bench", "sim", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "sim.json").read_text())
    assert report["overrides"] == ["modes.jump=null"] and report["config"]["steps"] == 10
    assert 0 < report["numbers"]["sim_over_bare_physics"] < 1.5
    assert (tmp_path / "out" / "sim.png").is_file()
    assert "sim_over_bare_physics" in done.stdout
