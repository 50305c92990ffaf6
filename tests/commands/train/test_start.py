"""What comes before a training: wrong command lines leave nothing, and every start has a directory of its own."""

from __future__ import annotations

import datetime
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from hydra.core.utils import JobReturn

from helpers.programs import SMALL, program
from ogmp_sb3.commands.train import program as train_program
from ogmp_sb3.commands.train.failures import Failures
from ogmp_sb3.runs.run_directory import CONFIG, FAILURE
from ogmp_sb3.runs.training import Job

NOON = datetime.datetime(2026, 1, 31, 12, 0, 0)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """The jobs of command lines, which begin at noon and train nothing."""
    jobs: list[Job] = []

    def begin(job: Job) -> float:
        jobs.append(job)
        (job.run_dir / CONFIG).touch()
        return 1.0

    monkeypatch.setattr(train_program, "begin_or_go_on", begin)
    monkeypatch.setattr("hydra.core.utils.datetime", SimpleNamespace(now=lambda: NOON))
    return jobs


@pytest.mark.parametrize(
    "arguments",
    [
        ["task=dive", "rh=0.3"],
        ["task=dive", "rho=-1"],
        ["task=dvie"],
        ["task=dive", "seed=-1"],
        ["task=dive", "seed=${nothing}"],
        ["task=dive", "hydra/launcher=nothing"],
        ["-m", "task=dive", "seed=-1"],
        ["-m", "task=dive,parkour", "rho=-1,-2"],
        ["-m", "task=dive", "rho=-1,-2", "hydra/launcher=joblib"],
        ["-m", "+experiment=rho", "task=dive", "seed=-1"],
        ["-m", "+search=rho", "task=dive", "num_envs=0"],
        ["-m", "task=dive", "hydra/sweeper=halving"],
        ["task=dive", "hydra.run.dir=a/b", "rho=-1"],
        ["-m", "task=dive", "hydra.sweep.dir=a/b", "rho=-1,-2"],
    ],
)
def test_a_wrong_command_line_leaves_nothing(arguments: list[str], started: list[Job], tmp_path: Path) -> None:
    done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("ogmp-train: ") == 1 and "Traceback" not in done.stderr
    assert not started and not list(tmp_path.iterdir())


def test_what_is_found_wrong_only_later_leaves_nothing_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(job: Job) -> float:
        (job.run_dir / "encoder").mkdir()
        raise ValueError("cannot be built")

    monkeypatch.setattr(train_program, "begin_or_go_on", begin)
    for given in ([], ["hydra.run.dir=a/b"]):
        done = program("train", "task=dive", *given, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (2, "ogmp-train: cannot be built\n")
        assert not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    program("train", "task=dive", "hydra.run.dir=mine", cwd=tmp_path)
    assert "cannot be built" in (tmp_path / "mine" / "train.log").read_text()  # the directory was there before


def test_a_job_of_several_that_is_wrong_is_told_in_its_directory(started: list[Job], tmp_path: Path) -> None:
    done = program("train", "-m", "task=dive", "rho=-1,0.5,-2", "hydra.sweep.dir=sweep", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("'rho' must be above 0") == 2
    assert [job.task.rho for job in started] == [0.5]
    failed = sorted(path.parent for path in (tmp_path / "sweep").rglob(FAILURE))
    assert len(failed) == 2
    for folder in failed:
        assert "ERROR" in (folder / "train.log").read_text() and "'rho' must be" in (folder / "train.log").read_text()


def test_starts_in_one_second_have_directories_of_their_own_in_the_order_of_time(
    started: list[Job], tmp_path: Path
) -> None:
    for _ in range(3):
        assert program("train", "task=dive", cwd=tmp_path).returncode == 0
    names = [job.run_dir.name for job in started]
    assert names == ["2026-01-31_12-00-00", "2026-01-31_12-00-00_02", "2026-01-31_12-00-00_03"]
    assert sorted([*names, "2026-01-31_12-00-01"])[:3] == names
    assert {job.run_dir.parent for job in started} == {tmp_path / "runs" / "dive"}


def test_sweeps_in_one_second_have_directories_of_their_own(started: list[Job], tmp_path: Path) -> None:
    for task in ("dive", "parkour"):
        done = program("train", "-m", f"task={task}", "seed=1,2", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    folders = sorted((tmp_path / "runs" / "sweeps").iterdir())
    assert [folder.name for folder in folders] == ["2026-01-31_12-00-00", "2026-01-31_12-00-00_02"]
    assert [job.run_dir.parent for job in started] == [folders[0]] * 2 + [folders[1]] * 2
    for folder, task in zip(folders, ("dive", "parkour"), strict=True):
        multirun = yaml.safe_load((folder / "multirun.yaml").read_text())
        assert multirun["hydra"]["overrides"]["task"][0] == f"task={task}"


def test_a_directory_that_is_given_is_taken_as_it_is(started: list[Job], tmp_path: Path) -> None:
    given = ["hydra.run.dir=mine", "hydra.run.dir=mine/${now:%H-%M-%S}"]
    for directory in given * 2:
        assert program("train", "task=dive", directory, cwd=tmp_path).returncode == 0
    assert {job.run_dir for job in started} == {tmp_path / "mine", tmp_path / "mine" / "12-00-00"}
    for _ in range(2):  # that of a ready sweep is fixed, so that the same command goes on with it
        words = ["-m", "+experiment=unguided", "task=dive", "hydra/launcher=basic"]
        assert program("train", *words, cwd=tmp_path).returncode == 0
    ready = tmp_path / "runs" / "experiments" / "unguided" / "dive"
    assert {job.run_dir.parent for job in started[4:]} == {ready}


@pytest.mark.parametrize("chdir", ["false", "true"])
def test_settings_may_refer_to_the_environment_the_job_and_one_another(
    chdir: str, started: list[Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "7")
    words = ["seed=${oc.env:SLURM_ARRAY_TASK_ID}", "rho=${seed}", "total_timesteps=${num_envs}", "task.horizon=${seed}"]
    words += ["episode_steps=${task.evaluation.episode_steps}", f"hydra.job.chdir={chdir}"]
    done = program("train", "task=dive", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (job,) = started
    assert (job.config.seed, job.config.total_timesteps, job.task.rho, job.task.horizon) == (7, 64, 7.0, 7)
    assert (job.task_data["rho"], job.task_data["horizon"]) == (7, 7)  # what is stored is the value
    assert job.task.episode_steps == job.task.evaluation.episode_steps
    done = program("train", "-m", "task=dive", "rho=0.1,0.2", "seed=${hydra:job.num}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [(job.config.seed, job.task_data["rho"]) for job in started[1:]] == [(0, 0.1), (1, 0.2)]


@pytest.mark.parametrize("mode", [[], ["-m", "seed=1,2"]])
def test_paths_start_where_the_command_was_given(mode: list[str], started: list[Job], tmp_path: Path) -> None:
    from ogmp_sb3.config.catalogue import PACKAGE, ROBOTS_DIR

    (tmp_path / "mine").mkdir()
    for name, source in (("robot", ROBOTS_DIR / "hector"), ("eyes", PACKAGE / "encoders" / "dive")):
        (tmp_path / "mine" / name).symlink_to(source)
    text = (PACKAGE / "tasks" / "dive.yaml").read_text()
    data = yaml.safe_load(text) | {"robot": "robot/robot.yaml", "encoder": "mine/eyes"}
    (tmp_path / "mine" / "hop.yaml").write_text(yaml.safe_dump(data))
    done = program("train", *mode, "task=mine/hop.yaml", "hydra.job.chdir=true", *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(started) == max(len(mode), 1)
    for job in started:
        assert job.task.robot_config.path.samefile(ROBOTS_DIR / "hector" / "robot.yaml")
        assert job.task.encoder == str(tmp_path / "mine" / "eyes")
        assert job.run_dir.is_absolute() and (job.run_dir / CONFIG).is_file()


def test_a_job_that_failed_has_no_value_and_one_that_did_not_has_a_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To sweepers that search, such as Optuna's: nan would end a search."""
    values = iter([float("nan"), 2.5])
    monkeypatch.setattr(train_program, "begin_or_go_on", lambda job: next(values))
    returned: list[object] = []

    def seen(self: Failures, config: object, job_return: JobReturn, **kwargs: object) -> None:
        returned.append(job_return.return_value)

    monkeypatch.setattr(Failures, "on_job_end", seen)
    done = program("train", "-m", "task=dive", "rho=0.1,-1,0.2", "hydra.sweep.dir=sweep", cwd=tmp_path)
    assert returned == [None, None, 2.5]
    assert done.stderr.startswith("ogmp-train: ") and "'rho' must be above 0" in done.stderr
