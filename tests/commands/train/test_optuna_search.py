"""The search by Optuna on a command line: trained in earnest, on launchers, and told what is wrong."""

from __future__ import annotations

import builtins
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from helpers.programs import SMALL, program
from ogmp_sb3.commands.train import optuna_search
from ogmp_sb3.commands.train.optuna_search import OptunaSweeper, objective, with_folder
from ogmp_sb3.commands.train.space import Space
from ogmp_sb3.commands.train.sweeper import HOME
from ogmp_sb3.commands.train.trials import SearchConfig
from ogmp_sb3.runs.multirun import read_sweep, setting
from ogmp_sb3.runs.run_directory import MULTIRUN, Run, checkpoint_dirs
from ogmp_sb3.runs.storage import write_yaml

SEARCH = ["-m", "hydra/sweeper=optuna", "task=dive", *SMALL, "evaluation.episode_steps=10", "hydra.sweeper.episodes=2"]


@pytest.fixture
def optuna() -> Any:
    return pytest.importorskip("optuna", reason="needs the extra 'optuna'")


def made_up(known: object, folder: Path, job: Run, samples: int, episodes: int) -> list[float]:
    """A score that only rho decides."""
    return [float(setting(job, "rho")), 0.0]


def same_training(one: Path, other: Path) -> None:
    """The last checkpoints hold the same numbers, of the policy and of all that goes on from there."""
    ends = [checkpoint_dirs(run)[-1] for run in (one, other)]
    assert ends[0].name == ends[1].name
    for file in ("policy.safetensors", "trainer.safetensors"):
        assert (ends[0] / file).read_bytes() == (ends[1] / file).read_bytes()


def test_a_trial_that_was_pruned_and_promoted_is_bit_for_bit_one_that_ran_through(
    optuna: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(optuna_search, "scored", made_up)
    arguments = [*SEARCH, "rho=0.1,0.4", "total_timesteps=512", "hydra.sweeper.reduction=2"]
    done = program("train", *arguments, "hydra.sweeper.n_trials=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "runs/search/rho/dive"
    (alone,) = read_sweep(folder)
    study = (folder / "study.journal").read_text().replace(" ", "")
    assert study.count(f'"goes_on":"rho={setting(alone, "rho")}"') == 2  # it stopped at two rungs: none was worse yet
    assert done.stdout.count("resumed at step") == 2 and alone.samples == 512

    words = [word for word in SEARCH[2:] if not word.startswith("hydra")]
    rho = f"rho={setting(alone, 'rho')}"
    through = program("train", *words, rho, "total_timesteps=512", "hydra.run.dir=through", cwd=tmp_path)
    assert through.returncode == 0, through.stderr
    same_training(alone.path, tmp_path / "through")

    more = program("train", *arguments, "hydra.sweeper.n_trials=2", cwd=tmp_path)  # the same command, with more
    assert more.returncode == 0, more.stderr
    assert len(read_sweep(folder)) == 2
    assert "Best: rho=0.4." in more.stdout


@pytest.mark.parametrize("launcher", ["joblib", "ray"])
def test_two_workers_of_a_launcher_train_the_trials(launcher: str, optuna: Any, tmp_path: Path) -> None:
    if importlib.util.find_spec(f"hydra_plugins.hydra_{launcher}_launcher") is None:
        pytest.skip(f"the launcher '{launcher}' is not installed")
    words = ["rho=interval(0.2,0.8)", "ppo.learning_rate=tag(log,interval(1e-4,1e-3))", "oracle=lqr,preview"]
    settings = ["hydra.sweeper.n_jobs=2", "hydra.sweeper.rungs=2", "hydra.sweeper.reduction=2", "total_timesteps=256"]
    arguments = [*SEARCH, *words, *settings, "hydra.sweeper.n_trials=2"]
    of_launcher = {
        "joblib": ["hydra.launcher.n_jobs=2"],
        "ray": ["+hydra.launcher.ray.init.num_cpus=2", "+hydra.launcher.ray.init.include_dashboard=false"],
    }
    arguments += [f"hydra/launcher={launcher}", *of_launcher[launcher]]
    command = [sys.executable, "-m", "ogmp_sb3.commands.train.program", *arguments]
    environment = {**os.environ, "HOME": str(tmp_path)}  # where Ray keeps its token
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Best: rho=0." in done.stdout
    folder = tmp_path / "runs/search/oracle+ppo.learning_rate+rho/dive"
    jobs = read_sweep(folder)
    assert sorted(job.samples for job in jobs) == [128, 256]
    assert all(0.2 <= setting(job, "rho") <= 0.8 for job in jobs)
    assert all(1e-4 <= setting(job, "ppo.learning_rate") <= 1e-3 for job in jobs)
    lines = [json.loads(line) for line in (folder / "optuna.jsonl").read_text().splitlines() if line]
    assert {line["settings"]["stream"] for line in lines} == {"selection"}  # tracks that no test has


def test_a_trial_whose_job_fails_is_out_and_told_at_the_end(
    optuna: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(optuna_search, "scored", made_up)
    arguments = [*SEARCH, "rho=0.1,-1", "total_timesteps=128", "hydra.sweeper.rungs=1", "hydra.sweep.dir=search"]
    done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "Best: rho=0.1." in done.stdout
    assert "'rho' must be above 0" in done.stderr and done.stderr.count("ogmp-train: ") == 1


def test_with_several_seeds_the_mean_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"rho=0.1 seed=0": 1.0, "rho=0.1 seed=1": 0.0, "rho=0.3 seed=0": 0.7, "rho=0.3 seed=1": 0.5}
    launched: list[list[str]] = []

    def launch(sweeper: OptunaSweeper, batch: list[list[str]]) -> list[Path | None]:
        launched.extend(batch)
        return [None if "rho=0.2" in job else tmp_path / " ".join(job[1:3]) for job in batch]

    monkeypatch.setattr(OptunaSweeper, "_launch", launch)
    monkeypatch.setattr(optuna_search, "read_run", lambda path: path)
    monkeypatch.setattr(optuna_search, "scored", lambda known, folder, job, *_: [scores[job.name], 0.0])
    space = Space(("task=dive",), {"rho": None}, ("seed=0", "seed=1"))
    values = {f"rho={rho}": {"rho": rho} for rho in (0.1, 0.2, 0.3)}
    trials = SimpleNamespace(space=space, values=values, budget=lambda name: 64, config=SearchConfig())
    found = OptunaSweeper({})._train(tmp_path, trials, list(values))  # type: ignore[arg-type]
    assert found == {"rho=0.1": 0.5, "rho=0.2": None, "rho=0.3": 0.6}
    assert launched[1] == ["task=dive", "rho=0.1", "seed=1", "total_timesteps=64"]


WRONG = [
    (["rho=0.3"], "a search needs a key whose values it chooses: give an interval, rho=interval(0.2,0.8), or"),
    (["rho=[0.2,0.8]", "oracle=lqr,preview"], "tasks/dive.yaml: 'rho' must be a number, found the list [0.2, 0.8]."),
    (["rho=0.2:0.8", "oracle=lqr,preview"], "'rho' must be a number, found the text '0.2:0.8'"),
    (["oracle=interval(0,1)"], "'oracle' must be"),
    (["rho=interval(a,b)"], "'rho=interval(a,b)' must have the form key=value as Hydra reads it"),
    (["rho=interval(0,0.8)"], "'rho' must be above 0"),
    (["horizon=interval(7,30)"], "'horizon' must be a whole number, found the number 15.786"),
    (["rho=interval(0.2,0.8)", "hydra.sweeper.n_trials=0"], "'n_trials' must be"),
    (["rho=interval(0.2,0.8)", "hydra.sweeper.n_trials=few"], "'hydra.sweeper.n_trials' must be a whole number"),
    (
        ["rho=interval(0.2,0.8)", "hydra.sweeper.pruner=median_"],
        "'hydra.sweeper.pruner' is the text 'median_' (allowed:",
    ),
    (["rho=interval(0.2,0.8)", "hydra.sweeper.n_trial=3"], "n_trial"),
    (["rhoo=interval(0.2,0.8)"], "'rhoo' is not a known key"),
    (["rho=interval(0.2,0.8)", "total_timesteps=8"], "'total_timesteps' is 8: too few for 3 rungs"),
]


@pytest.mark.parametrize(
    ("words", "message"), WRONG, ids=lambda value: " ".join(value) if isinstance(value, list) else ""
)
def test_bad_input_is_told_in_a_sentence_before_any_training(
    optuna: Any, words: list[str], message: str, tmp_path: Path
) -> None:
    done = program("train", *SEARCH, *words, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.startswith("ogmp-train: ") and len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("there", "here"), [("optuna", "halving"), ("halving", "optuna")])
def test_a_directory_of_another_kind_of_search_is_told_in_a_sentence(
    there: str, here: str, optuna: Any, tmp_path: Path
) -> None:
    names = {name: f"{name.capitalize()}Sweeper" for name in (there, here)}
    (tmp_path / "old").mkdir()
    sweeper = {"_target_": f"{HOME}.{names[there]}"}
    write_yaml(tmp_path / "old" / MULTIRUN, {"hydra": {"sweeper": sweeper}})
    arguments = [*SMALL, "task=dive", "rho=0.1,0.3", "total_timesteps=128", "hydra.sweep.dir=old"]
    done = program("train", "-m", f"hydra/sweeper={here}", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        f"ogmp-train: old: holds a search by the {names[there]}, where this one is by the {names[here]}. "
        "Choose another directory: hydra.sweep.dir=...\n"
    )
    assert [path.name for path in (tmp_path / "old").iterdir()] == [MULTIRUN]


def test_its_absence_is_told_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, imported = importlib.util.find_spec, builtins.__import__
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "optuna" else found(name, *a))

    def without(name: str, *arguments: Any) -> Any:
        if name.partition(".")[0] == "optuna":
            raise ModuleNotFoundError(name)
        return imported(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", without)
    done = program("train", *SEARCH, "rho=interval(0.2,0.8)", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "ogmp-train: the package 'optuna' is missing: pip install \"ogmp_sb3[optuna]\".\n",
    )
    assert list(tmp_path.iterdir()) == []


def test_a_search_is_on_one_task(tmp_path: Path) -> None:
    done = program("train", "-m", "hydra/sweeper=optuna", "task=dive,stairs", "rho=0.1,0.2", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "ogmp-train: a search compares values on one task, found 2: search on each of them.\n"


def test_the_directory_is_named_after_what_is_searched_unless_it_has_a_name() -> None:
    words = [
        "hydra/sweeper=optuna",
        "task=dive",
        "task.rho=interval(0,1)",
        "seed=0,1",
        "oracle=lqr,preview",
        "horizon=7",
    ]
    assert with_folder(words)[-1] == "hydra.sweep.dir=runs/search/oracle+rho/${hydra.runtime.choices.task}"
    for same in ([*words, "hydra.sweep.dir=mine"], words[1:]):
        assert with_folder(same) == same


def test_the_return_tells_apart_those_that_reach_the_same_and_no_others() -> None:
    assert objective(0.0, 1.0) > objective(0.0, 0.5) > objective(0.0, -3.0)
    assert objective(0.0, 300.0) > objective(0.0, 299.0)
    assert objective(0.001, -1e6) > objective(0.0, 1e6)
