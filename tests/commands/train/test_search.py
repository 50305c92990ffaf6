"""Successive halving, with made-up scores and for real."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf

from helpers.programs import SMALL, program
from ogmp_sb3.commands.train import search as halving
from ogmp_sb3.commands.train.search import EPISODES, ROUNDS, HalvingSweeper, expanded
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import estimate
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.multirun import read_sweep, setting
from ogmp_sb3.runs.run_directory import Run
from ogmp_sb3.runs.storage import write_yaml


@pytest.fixture
def played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """What was trained: values and samples. The score of a value is the value, but for 0.05, which starts well."""
    trained: list[tuple[str, int]] = []

    class Launcher:
        def launch(self, batch: list[list[str]], initial_job_idx: int) -> list[JobReturn]:
            results = []
            for job in batch:
                given = dict(argument.removeprefix("task.").partition("=")[::2] for argument in job)
                trained.append((given["rho"], int(given["total_timesteps"])))
                rho = given["rho"].strip("'")
                folder = tmp_path / "search" / f"rho={rho}"
                folder.mkdir(parents=True, exist_ok=True)
                (folder / "progress.csv").write_text(f"{STEP_COLUMN}\n{trained[-1][1]}\n")
                write_yaml(folder / "config.yaml", {"task": {"rho": float(rho)}, "train": {"total_timesteps": 0}})
                hydra = OmegaConf.create({"hydra": {"runtime": {"output_dir": str(folder)}}})
                results.append(JobReturn(hydra_cfg=hydra, status=JobStatus.COMPLETED))
            return results

    def score(job: halving.Run, episodes: int) -> list[float]:
        rho = float(setting(job, "rho"))
        return [1.0 if rho == 0.05 and trained[-1][1] <= 100 else rho, 0.0]

    monkeypatch.setattr(halving, "_score", score)
    monkeypatch.setattr(HalvingSweeper, "launcher", Launcher(), raising=False)
    monkeypatch.setattr(HalvingSweeper, "validate_batch_is_legal", lambda self, batch: None)
    return trained


def run(tmp_path: Path, *arguments: str) -> None:
    """A search over rho, by the words that ``+search=rho`` is short for."""
    words = expanded(["+search=rho", "task=parkour", "total_timesteps=800", *arguments])
    sweeper = HalvingSweeper("rho", ROUNDS, EPISODES, {})
    hydra = {"sweep": {"dir": str(tmp_path / "search")}, "sweeper": {"_target_": "HalvingSweeper"}}
    sweep = {"hydra": hydra, "total_timesteps": 800}
    sweeper.config = OmegaConf.create(sweep)
    sweeper.sweep([word for word in words if word != "-m" and not word.startswith("hydra")])


def test_the_better_half_trains_twice_as_long(played, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path)
    eight = [(value, 100) for value in ("0.05", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.8")]
    four = [(value, 200) for value in ("0.05", "0.8", "0.6", "0.5")]
    assert played == eight + four + [("0.8", 400), ("0.6", 400), ("0.8", 800)]
    assert "Best: rho=0.8. 2,000 samples; the full grid takes 6,400." in capsys.readouterr().out


def test_values_on_the_command_line_count(played, tmp_path: Path) -> None:
    run(tmp_path, "rho=0.10,0.3")
    assert played == [("0.1", 100), ("0.3", 100), ("0.3", 200), ("0.3", 400), ("0.3", 800)]


def test_the_seeds_of_a_value_count_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {(0.1, 0): 1.0, (0.1, 1): 0.0, (0.3, 0): 0.7, (0.3, 1): 0.5}
    jobs: dict[str, list[Run]] = {"0.1": [], "0.3": []}
    for rho, seed in scores:
        overrides = (f"rho={rho}", f"seed={seed}")
        jobs[str(rho)].append(Run(tmp_path / f"{rho}-{seed}", overrides, {}, {}, "finished"))
    monkeypatch.setattr(
        halving, "_score", lambda job, episodes: [scores[setting(job, "rho"), setting(job, "seed")], 0.0]
    )
    assert halving._ranked(tmp_path, jobs, 100) == [
        ([pytest.approx(0.6), 0.0], "0.3"),
        ([0.5, 0.0], "0.1"),
    ]


def test_scores_are_kept(played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path, "rho=0.1,0.3")
    before = list(played)
    monkeypatch.setattr(halving, "_score", lambda job, episodes: pytest.fail("was computed again"))
    run(tmp_path, "rho=0.1,0.3")
    assert played == before * 2


def test_scores_are_measured_on_tracks_that_no_test_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    streams: list[str] = []

    class Subject:
        def __init__(self, *arguments: object) -> None:
            pass

        def evaluation(self, episodes: int, seed: int, progress: object, stream: str = "test") -> Evaluation:
            streams.append(stream)
            return Evaluation({name: estimate([1.0]) for name in ("true_objective", "return")}, {}, 0.0, {})

    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.EvaluatedPolicy", Subject)
    monkeypatch.setattr(halving, "load_policy", lambda path: None)
    assert halving._score(Run(tmp_path, (), {}, {}, "finished"), 4) == [1.0, 1.0]
    assert streams == ["selection"]


def test_scores_are_not_those_of_another_training_in_the_same_directory(played, tmp_path: Path) -> None:
    run(tmp_path, "rho=0.1,0.3")
    for file in (tmp_path / "search").glob("rho=*/config.yaml"):
        write_yaml(file, {**read_yaml(file), "task": {"rho": 0.0}})
    (job,) = (job for job in read_sweep(tmp_path / "search") if job.path.name == "rho=0.3")
    with pytest.raises(ValueError, match=r"trained on \d+ samples already, where this search compares after 100"):
        halving._ranked(tmp_path / "search", {"0.0": [job]}, 100)
    assert halving._ranked(tmp_path / "search", {"0.0": [job]}, job.samples) == [([0.0, 0.0], "0.0")]


@pytest.mark.parametrize("values", ["choice(0.1,0.3)", "range(1,3)"])
def test_values_that_hydra_would_work_out_are_refused_before_any_training(values: str, played, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a search takes plain values with commas between them"):
        run(tmp_path, f"rho={values}")
    assert played == []


def test_a_real_search_trains_and_ranks(tmp_path: Path) -> None:
    arguments = ["-m", "+search=rho", "task=dive", "rho=0.1,0.4", "total_timesteps=1024", *SMALL]
    done = program("train", *arguments, "hydra/launcher=basic", "task.evaluation.episode_steps=10", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1,152 samples; the full grid takes 2,048." in done.stdout
    assert done.stdout.count("kept") == 4 and done.stdout.count("dropped") == 1


def test_a_search_over_anything_else_needs_its_values(played, tmp_path: Path) -> None:
    done = program("train", "-m", "+search=roh", "task=dive", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "ogmp-train: '+search=roh' needs the values that it compares: roh=<value>,<value>,...\n"
    with pytest.raises(ValueError, match="'rho' is given twice"):
        run(tmp_path, "rho=0.1,0.2", "task.rho=0.3,0.4")
    assert played == []


def test_a_value_whose_job_failed_is_out_and_the_others_go_on(tmp_path: Path) -> None:
    arguments = ["-m", "+search=rho", "task=dive", "rho=0.1,-1,0.4", "total_timesteps=256", *SMALL]
    quick = ["hydra/launcher=basic", "hydra.sweeper.episodes=2", "evaluation.episode_steps=10"]
    done = program("train", *arguments, *quick, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout.count("dropped") == 1 and "Best: rho=" in done.stdout
    assert "'rho' must be above 0" in done.stderr and done.stderr.count("ogmp-train: ") == 1


def test_values_may_be_in_quotes(played, tmp_path: Path) -> None:
    run(tmp_path, "rho='0.1','0.3'")
    assert [value for value, _ in played] == ["'0.1'", "'0.3'", "'0.3'", "'0.3'", "'0.3'"]


@pytest.mark.parametrize("words", [["+search=rho"], ["hydra/sweeper=halving", "rho=0.1,0.2", "hydra.sweep.dir=s"]])
def test_a_search_is_on_one_task(words: list[str], tmp_path: Path) -> None:
    done = program("train", "-m", *words, "task=dive,stairs", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "ogmp-train: a search compares values on one task, found 2: search on each of them.\n"


def test_a_key_with_its_prefix_is_the_same_key(played, tmp_path: Path) -> None:
    run(tmp_path, "task.rho=0.10,0.3")
    assert played[:2] == [("0.1", 100), ("0.3", 100)]


def test_a_search_is_over_the_key_as_it_was_typed_in_a_directory_of_its_task() -> None:
    words = expanded(["+search=action.noise", "task=tasks/dive.yaml", "task.action.noise=0.1,0.2"])
    folder = "hydra.sweep.dir=runs/search/action.noise/${hydra.runtime.choices.task}"
    assert {"task.action.noise=0.1,0.2", "hydra.sweeper.key=action.noise", folder} <= set(words)
    assert not any(word.startswith("action.noise=") for word in words)


def test_a_search_on_a_launcher_goes_on_where_the_one_before_stopped(tmp_path: Path) -> None:
    arguments = ["-m", "hydra/sweeper=halving", "hydra.sweeper.rounds=2", "hydra.sweeper.episodes=2", "task=dive"]
    arguments += ["rho=0.1,0.4", *SMALL, "evaluation.episode_steps=10", "hydra.sweep.dir=search"]
    command = [sys.executable, "-m", "ogmp_sb3.commands.train.program", *arguments, "hydra/launcher=joblib"]
    apart = subprocess.run([*command, "total_timesteps=256"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert apart.returncode == 0, apart.stderr
    longer = program("train", *arguments, "hydra/launcher=basic", "total_timesteps=512", cwd=tmp_path)
    assert longer.returncode == 0, longer.stderr
    assert "resumed at step 256" in longer.stdout
    for printed in (apart.stdout, longer.stdout):
        assert "Best: rho=" in printed and printed.count("dropped") == 1
    assert len(list((tmp_path / "search").glob("*/config.yaml"))) == 2
    assert len(read_sweep(tmp_path / "search")) == 2
