"""Sweeps: their jobs, found or missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from helpers.run_directories import make_run
from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.runs.multirun import read_runs, read_sweep, setting, swept_keys
from ogmp_sb3.runs.run_directory import read_run


def test_a_setting_is_that_of_the_command_line_or_else_of_the_configuration(tmp_path: Path) -> None:
    run = read_run(make_run(tmp_path / "run", ["task=parkour", "rho=null", "+task.horizon=15", "task.bound={z:1}"]))
    assert setting(run, "rho") is None
    assert setting(run, "horizon") == 15
    assert setting(run, "bound") == {"z": 1}
    assert (setting(run, "oracle"), setting(run, "action.scale"), setting(run, "seed")) == ("preview", 2.0, 0)
    assert setting(run, "nonsense") is None
    twice = read_run(make_run(tmp_path / "twice", ["rho=0.1", "rho=0.5", "task.rho=0.3", "task.horizon=7"]))
    assert (setting(twice, "rho"), setting(twice, "horizon")) == (0.5, 7)  # as in training
    assert run.command == "ogmp-train task=parkour rho=null +task.horizon=15 'task.bound={z:1}'"


def make_sweep(folder: Path, sweeper: str = "hydra._internal.core_plugins.basic_sweeper.BasicSweeper") -> Path:
    """Six jobs were asked for; one finished, one was stopped, one failed, three were never started."""
    make_run(folder / "0", ["task=parkour", "rho=0.3", "oracle=linear"], steps=1000, checkpoint=1000)
    make_run(folder / "1", ["task=parkour", "rho=0.3", "oracle=lqr"], steps=300, checkpoint=256)
    make_run(folder / "2", ["task=parkour", "rho=0.5", "oracle=linear"], config=False)
    (folder / "report").mkdir()
    (folder / "report" / "report.html").write_text("an earlier page")
    overrides = {"hydra": ["hydra.mode=MULTIRUN"], "task": ["task=parkour", "rho=0.3,0.5,null", "oracle=linear,lqr"]}
    hydra = {"sweeper": {"_target_": sweeper}, "overrides": overrides, "job": {"num": "???"}}
    (folder / "multirun.yaml").write_text(yaml.safe_dump({"hydra": hydra}))
    return folder


def test_a_sweep_lists_every_job_that_was_asked_for_in_order(tmp_path: Path) -> None:
    jobs = read_sweep(make_sweep(tmp_path))
    assert [(setting(job, "rho"), setting(job, "oracle"), job.state) for job in jobs] == [
        (0.3, "linear", "finished"),
        (0.3, "lqr", "stopped"),
        (0.5, "linear", "failed"),
        (0.5, "lqr", "missing"),
        (None, "linear", "missing"),
        (None, "lqr", "missing"),
    ]
    assert swept_keys(jobs) == ["rho", "oracle"]


def write_multirun(folder: Path, given: list[str], params: dict[str, str] | None = None) -> None:
    """``multirun.yaml`` as Hydra writes it."""
    folder.mkdir(parents=True, exist_ok=True)
    sweeper = {"_target_": "hydra._internal.core_plugins.basic_sweeper.BasicSweeper", "params": params}
    data = {"hydra": {"sweeper": sweeper, "overrides": {"task": given}}}
    (folder / "multirun.yaml").write_text(yaml.safe_dump(data))


def test_the_one_job_that_a_ready_sweep_misses_is_listed(tmp_path: Path) -> None:
    experiment = yaml.safe_load((PACKAGE / "conf" / "experiment" / "rho.yaml").read_text())
    params = experiment["hydra"]["sweeper"]["params"]
    values = params["rho"].split(",")
    write_multirun(tmp_path, ["+experiment=rho", "task=parkour", "seed=0,1"], params)
    for i, (rho, seed) in enumerate((rho, seed) for rho in values for seed in (0, 1)):
        if (rho, seed) != ("0.4", 1):
            overrides = [f"rho={rho}", "+experiment=rho", "task=parkour", f"seed={seed}"]
            make_run(tmp_path / str(i), overrides, steps=1000)
    jobs = read_sweep(tmp_path)
    assert len(jobs) == 2 * len(values)
    assert [(setting(job, "rho"), setting(job, "seed")) for job in jobs if job.state == "missing"] == [(0.4, 1)]
    assert swept_keys(jobs) == ["rho", "seed"]


def test_a_value_of_the_command_line_replaces_those_of_a_ready_sweep(tmp_path: Path) -> None:
    write_multirun(tmp_path, ["+experiment=rho", "task=parkour", "rho=0.7"], {"rho": "0.1,0.2"})
    make_run(tmp_path / "0", ["rho=0.7", "+experiment=rho", "task=parkour"], steps=1000)
    assert [job.state for job in read_sweep(tmp_path)] == ["finished"]


def test_a_job_is_found_however_its_values_were_typed(tmp_path: Path) -> None:
    typed = ["rho=.3,.5", "ppo.learning_rate=1e-4", "num_envs=1_000", "task.modes.jump.h=[0.2, 0.3]"]
    write_multirun(tmp_path, ["task=parkour", *typed])
    for rho in ("0.3", "0.5"):
        kept = [f"rho={rho}", "ppo.learning_rate=0.0001", "num_envs=1000", "task.modes.jump.h=[0.2,0.3]"]
        make_run(tmp_path / rho, ["task=parkour", *kept], steps=1000)
    assert [job.state for job in read_sweep(tmp_path)] == ["finished", "finished"]


def test_a_sweep_that_was_extended_lists_each_job_once_and_differs_in_no_budget(tmp_path: Path) -> None:
    write_multirun(tmp_path, ["task=parkour", "rho=0.3,0.5", "total_timesteps=2000"])
    make_run(tmp_path / "a", ["task=parkour", "rho=0.3", "total_timesteps=2000"], steps=1000)
    make_run(tmp_path / "b", ["task=parkour", "rho=0.5", "total_timesteps=1000"], steps=1000)
    make_run(tmp_path / "c", ["task=parkour", "rho=0.7", "total_timesteps=1000"], steps=1000)
    jobs = read_sweep(tmp_path)
    assert [(setting(job, "rho"), job.state) for job in jobs] == [(rho, "finished") for rho in (0.3, 0.5, 0.7)]
    assert swept_keys(jobs) == ["rho"]
    assert [setting(job, "rho") for job in read_sweep(tmp_path, asked=True)] == [0.3, 0.5]


def test_a_sweep_that_names_no_values_lists_what_is_there(tmp_path: Path) -> None:
    write_multirun(tmp_path, ["task=glob(*)"])
    make_run(tmp_path / "a", ["task=parkour"], steps=1000)
    assert [job.state for job in read_sweep(tmp_path)] == ["finished"]


def test_jobs_whose_values_have_slashes_are_found_and_a_sweep_within_is_left(tmp_path: Path) -> None:
    write_multirun(tmp_path, ["task=parkour", "task.encoder=encoders/mine,encoders/parkour"])
    for name in ("mine", "parkour"):
        overrides = ["task=parkour", f"task.encoder=encoders/{name}"]
        make_run(tmp_path / "task=parkour,task.encoder=encoders" / name, overrides, steps=1000)
    make_run(tmp_path / "another" / "0", ["task=parkour"], steps=1000)
    write_multirun(tmp_path / "another", ["task=parkour"])
    (tmp_path / "all").symlink_to(tmp_path)
    jobs = read_sweep(tmp_path)
    assert [(job.path.name, job.state) for job in jobs] == [("mine", "finished"), ("parkour", "finished")]


@pytest.mark.parametrize("file", ["progress.csv", "config.yaml", ".hydra/overrides.yaml"])
def test_a_job_with_a_damaged_file_is_listed_with_the_reason(file: str, tmp_path: Path) -> None:
    folder = make_sweep(tmp_path)
    (folder / "0" / file).write_text("\x00")
    jobs = read_sweep(folder)
    (damaged,) = (job for job in jobs if job.state == "damaged")
    assert f"0/{file}: not readable" in damaged.problem
    assert [job.state for job in jobs if job.path.name in ("1", "2")] == ["stopped", "failed"]
    missing = 4 if file.endswith("overrides.yaml") else 3  # whose command line it is that is damaged cannot be known
    assert sum(job.state == "missing" for job in jobs) == missing


def test_a_job_whose_configuration_has_another_type_is_damaged(tmp_path: Path) -> None:
    folder = make_sweep(tmp_path)
    (folder / "0" / "config.yaml").write_text("task: {}\ntrain: {total_timesteps: 20M}\n")
    (damaged,) = (job for job in read_sweep(folder) if job.state == "damaged")
    assert "'train.total_timesteps' must be a whole number, found the text '20M'" in damaged.problem


def test_a_sweep_whose_sweeper_chose_as_it_went_lists_what_is_there(tmp_path: Path) -> None:
    assert len(read_sweep(make_sweep(tmp_path, "hydra_plugins.optuna_sweeper.OptunaSweeper"))) == 3


def test_runs_put_into_one_directory_by_hand_are_a_sweep(tmp_path: Path) -> None:
    make_run(tmp_path / "a", ["task=parkour"], steps=100)
    make_run(tmp_path / "b", ["task=parkour", "rho=0.1"], steps=100)
    jobs = read_sweep(tmp_path)
    assert swept_keys(jobs) == ["rho"]
    assert [setting(job, "rho") for job in jobs] == [0.5, 0.1]  # one by its config.yaml


def test_a_directory_without_jobs_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no job of a multirun"):
        read_sweep(tmp_path)


def test_overrides_stay_text_and_what_is_none_is_a_sentence(tmp_path: Path) -> None:
    run_dir = make_run(tmp_path / "run", ["task=parkour"])
    file = run_dir / ".hydra" / "overrides.yaml"
    file.write_text("- rho=${oc.env:HOME}\n")
    assert read_run(run_dir).overrides == ("rho=${oc.env:HOME}",)
    for content in ("{a: 1}", "3", "!!python/object/apply:os.system [ls]", "\x00"):
        file.write_text(content)
        with pytest.raises(ValueError, match=r"overrides\.yaml: not readable as a list of overrides") as caught:
            read_run(run_dir)
        assert "\n" not in str(caught.value)


def edit_config(run: Path, change: Callable[[dict[str, Any]], None]) -> None:
    data = yaml.safe_load((run / "config.yaml").read_text())
    change(data)
    (run / "config.yaml").write_text(yaml.safe_dump(data))


def test_jobs_that_differ_in_more_than_their_command_lines_say_are_told_apart(tmp_path: Path) -> None:
    """A task file, or a default, that has changed between two trainings of the same command but for the seed."""
    runs = [make_run(tmp_path / str(seed), ["task=parkour", f"seed={seed}"]) for seed in range(3)]
    for seed, run in enumerate(runs):
        edit_config(run, lambda data, seed=seed: data["train"].update(seed=seed, torch_threads=seed))
        edit_config(run, lambda data, seed=seed: data["task"].update(description=f"tried {seed} times"))
    edit_config(runs[0], lambda data: data["task"].update(min_step_reward=None))  # off, as where it is not known yet
    assert swept_keys([read_run(run) for run in runs]) == ["seed"]
    edit_config(runs[2], lambda data: data["task"]["action"].update(scale=1.5))
    edit_config(runs[1], lambda data: data["task"].update(observations={"clock": {}}))
    jobs = [read_run(run) for run in runs]
    assert swept_keys(jobs) == ["seed", "action.scale", "observations.clock"]
    assert [setting(job, "action.scale") for job in jobs] == [2.0, 2.0, 1.5]


def test_what_a_swept_key_explains_is_no_difference_of_its_own(tmp_path: Path) -> None:
    for i, task in enumerate(("parkour", "dive", "dive")):
        run = make_run(tmp_path / str(i), [f"task={task}", f"seed={i}"])
        edit_config(run, lambda data, task=task: data["task"].update(horizon=30 if task == "parkour" else None))
    assert swept_keys(read_sweep(tmp_path)) == ["task", "seed"]


def test_a_robot_that_has_moved_is_the_same_robot(tmp_path: Path) -> None:
    for place, digest in (("a", "1"), ("b", "1"), ("c", "2")):
        run = make_run(tmp_path / place, ["task=parkour"])
        edit_config(run, lambda data, place=place: data["task"].update(robot=f"/{place}/robot.yaml"))
        edit_config(run, lambda data, digest=digest: data.update(robot={"digest": digest}))
    assert swept_keys([read_run(tmp_path / place) for place in "ab"]) == []
    assert swept_keys([read_run(tmp_path / place) for place in "abc"]) == ["robot"]


def test_runs_to_compare_are_read_once_each_from_directories_of_one_or_of_several(tmp_path: Path) -> None:
    single = make_run(tmp_path / "single", ["task=parkour"], steps=100)
    make_run(tmp_path / "more" / "a", ["task=parkour", "seed=1"], steps=100)
    make_run(tmp_path / "more" / "b", ["task=parkour", "seed=2"], steps=100)
    folders = [single, tmp_path / "more", tmp_path / "more" / "a", single / ".." / "single"]
    assert [setting(run, "seed") for run in read_runs(folders)] == [0, 1, 2]
    (single / "progress.csv").write_text("damaged")
    assert [run.state for run in read_runs([single])] == ["damaged"]
    with pytest.raises(ValueError, match="nowhere': no such directory"):
        read_runs([single, tmp_path / "nowhere"])
