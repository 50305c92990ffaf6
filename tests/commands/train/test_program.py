"""ogmp-train, ogmp-eval and ogmp-check as a user runs them, with budgets of seconds."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch as th
import yaml
from safetensors.torch import load_file
from stable_baselines3.common.callbacks import BaseCallback
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from helpers.paths import ROOT
from helpers.programs import SMALL, program, progress
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.runs.callbacks import EpisodeStatistics
from ogmp_sb3.runs.checkpoint import latest_checkpoint
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.runs.tracker_runs import RUNS

UMASK = 0o026  # of the user whose files are looked at: another than usual


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("train")
    arguments = ["task=parkour", "rho=0.4", "oracle=lqr", "total_timesteps=600", "checkpoint_interval=256", *SMALL]
    with umask(UMASK):
        done = program("train", *arguments, "hydra.run.dir=first", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "first"


def test_who_may_read_a_run_is_said_by_the_umask(run: Path) -> None:
    modes = {path: path.stat().st_mode & 0o777 for path in [run, *run.rglob("*")]}
    assert len(modes) > 20
    assert {path: mode for path, mode in modes.items() if mode != (0o777 if path.is_dir() else 0o666) & ~UMASK} == {}


def test_a_run_directory_holds_config_log_events_and_checkpoints(run: Path) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert config["task"]["rho"] == 0.4
    assert config["task"]["oracle"] == "lqr"
    assert config["train"]["num_envs"] == 8
    assert "mujoco" in config["versions"]
    assert progress(run)[-1] >= 600
    assert list(run.glob("events.out.tfevents.*"))
    assert [int(p.name) for p in checkpoint_dirs(run)] == [256, 512, 640]


def test_the_log_has_terms_causes_deviation_and_speed(run: Path) -> None:
    with (run / "progress.csv").open(newline="") as file:
        columns = next(csv.reader(file))
    for column in ("return", "length", "distance", "deviation", "level", "position_tracking", "torque_regulation"):
        assert f"episode/{column}" in columns
    assert "time/fps" in columns
    assert any(column.startswith("termination/") for column in columns)


@pytest.mark.parametrize("policy", ["best", "checkpoints/000000000512"])
def test_what_is_measured_of_a_policy_that_will_be_replaced_is_not_replaced_with_it(run: Path, policy: str) -> None:
    arguments = [f"run={run / policy}", "episodes=1", "evaluation.episode_steps=5"]
    done = program("eval", *arguments, cwd=run.parent)
    assert done.returncode == 0, done.stderr
    found = (run / "evaluation" / policy / "metrics.json").read_text()
    assert '"ci95": [\n    null,\n    null\n   ]' in found and "NaN" not in found  # of one episode


def test_a_policy_is_tensors_and_text_and_knows_its_task(run: Path) -> None:
    loaded = load_policy(run)
    assert (loaded.task.rho, loaded.task.oracle, loaded.task.name) == (0.4, "lqr", "parkour")
    assert loaded.policy.features_extractor.count > 0
    files = [path.relative_to(loaded.path) for path in loaded.path.rglob("*") if path.is_file()]
    assert {file.suffix for file in files if file.parts[0] != "robot"} == {".safetensors", ".json"}
    assert [str(file) for file in sorted(files) if file.parts[0] == "robot"] == ["robot/hector.xml", "robot/robot.yaml"]
    assert Path(loaded.task.encoder).parent == run  # the encoder it was trained with


def test_resume_goes_on_in_the_same_directory(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    before = progress(copy)
    weights = load_file(checkpoint_dirs(copy)[-1] / "policy.safetensors")
    done = program("train", f"resume={copy}", "total_timesteps=1100", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "resumed at step 640" in done.stdout
    assert progress(copy)[: len(before)] == before
    assert progress(copy) == sorted(set(progress(copy)))
    assert int(checkpoint_dirs(copy)[-1].name) == 1152
    after = load_file(checkpoint_dirs(copy)[-1] / "policy.safetensors")
    assert not th.equal(weights["action_net.weight"], after["action_net.weight"])


def test_the_logs_of_a_crashed_and_resumed_run_have_no_double_point(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    shutil.rmtree(checkpoint_dirs(copy)[-1])  # the crash came before this checkpoint, after its log
    done = program("train", f"resume={copy}", "total_timesteps=1100", cwd=tmp_path)
    assert "resumed at step 512" in done.stdout
    events = EventAccumulator(str(copy))
    events.Reload()
    steps = [event.step for event in events.Scalars("episode/return")]
    assert steps == sorted(set(steps))
    assert steps == progress(copy)


DISTURBED = (
    "task.randomisation={mass:{scale:[0.8,1.2]},friction:{coefficient:[0.5,1.2]},joint_offset:{spread:0.02},"
    "action_delay:{delay:[0,0.07],jitter:0.01},sensor_noise:{scale:0.1},push:{every:0.3,speed:0.3}}"
)


@pytest.mark.parametrize("task", [["task=parkour"], ["task=dive"], ["task=parkour", DISTURBED]])
def test_a_run_in_two_parts_equals_one_in_one_bit_for_bit(task: list[str], tmp_path: Path) -> None:
    arguments = [*task, *SMALL, "seed=4", "checkpoint_interval=300", "ppo.learning_rate_half_life=500"]
    assert program("train", *arguments, "total_timesteps=1280", "hydra.run.dir=whole", cwd=tmp_path).returncode == 0
    assert program("train", *arguments, "total_timesteps=640", "hydra.run.dir=parts", cwd=tmp_path).returncode == 0
    again = program("train", "resume=parts", "total_timesteps=1280", cwd=tmp_path)
    assert "resumed at step 640" in again.stdout
    whole, parts = checkpoint_dirs(tmp_path / "whole")[-1], checkpoint_dirs(tmp_path / "parts")[-1]
    assert whole.name == parts.name
    for name in ("policy.safetensors", "trainer.safetensors", "trainer.json"):
        if name.endswith("json"):
            first, second = (json.loads((folder / name).read_text()) for folder in (whole, parts))
            for state in (first, second):
                for episode in state["episodes"]:
                    del episode["t"]
                state["statistics"]["sums"].pop("t", None)
                del (
                    state["statistics"]["best"],
                    state["statistics"]["best_at"],
                )  # of the checkpoints written, which come at other samples
            assert first == second
        else:
            first, second = (load_file(folder / name) for folder in (whole, parts))
            assert first.keys() == second.keys()
            different = [key for key in first if not th.equal(first[key], second[key])]
            assert not different


def test_a_damaged_checkpoint_is_passed_over_with_a_warning(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    newest = checkpoint_dirs(copy)[-1] / "trainer.safetensors"
    newest.write_bytes(newest.read_bytes()[:-100])
    with pytest.warns(UserWarning, match=r"trainer.safetensors: damaged or missing.*Falling back"):
        done = program("train", f"resume={copy}", "total_timesteps=700", cwd=tmp_path)
    assert "resumed at step 512" in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_save_and_say_how_to_go_on(number: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ogmp_sb3.commands.train.program", "task=dive", *SMALL, "hydra.run.dir=run"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not (tmp_path / "run" / "progress.csv").is_file() and time.monotonic() < deadline:
            time.sleep(0.2)
        time.sleep(2.0)
        process.send_signal(number)
        out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert f"ogmp-train resume={tmp_path / 'run'}" in out
    stopped_at = int(re.search(r"Stopped at step (\d+)", out)[1])
    assert stopped_at > 0
    assert int(latest_checkpoint(tmp_path / "run").name) == stopped_at


def test_a_second_ctrl_c_quits_at_once_without_a_traceback(tmp_path: Path, monkeypatch) -> None:
    def interrupted(self: BaseCallback) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(EpisodeStatistics, "_on_rollout_end", interrupted)
    done = program("train", "task=dive", *SMALL, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 130
    assert "press Ctrl-C again to quit at once" in done.stderr and "Traceback" not in done.stderr


def test_training_and_evaluation_need_no_network(tmp_path: Path, monkeypatch) -> None:
    def connect(*address: object) -> None:
        raise AssertionError(f"wants the network: {address}")

    for name in ("connect", "connect_ex", "bind"):
        monkeypatch.setattr(socket.socket, name, connect)
    monkeypatch.setattr(socket, "getaddrinfo", connect)
    assert (
        program("train", "task=dive", "total_timesteps=128", *SMALL, "hydra.run.dir=run", cwd=tmp_path).returncode == 0
    )
    done = program("eval", "run=run", "episodes=1", "evaluation.episode_steps=5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_multirun_trains_every_combination(tmp_path: Path) -> None:
    arguments = ["-m", "task=dive", "rho=0.2,null", "total_timesteps=128", *SMALL, "hydra.sweep.dir=sweep"]
    done = program("train", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = [yaml.safe_load(p.read_text())["task"]["rho"] for p in sorted((tmp_path / "sweep").glob("*/config.yaml"))]
    assert sorted(found, key=str) == [0.2, None]


def test_a_mistake_of_one_job_is_told_when_the_others_have_trained(tmp_path: Path) -> None:
    arguments = ["-m", "task=dive", "rho=-1,0.5", "total_timesteps=64", *SMALL, "hydra.sweep.dir=sweep"]
    for _ in range(2):
        done = program("train", *arguments, "hydra.sweep.subdir=${hydra.job.num}", cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1].startswith("ogmp-train: 0: ") and "'rho' must be above 0" in done.stderr
        assert done.stderr.count("ogmp-train: ") == 1 and "Traceback" not in done.stderr
        assert checkpoint_dirs(tmp_path / "sweep" / "1")
    assert "already" in done.stdout
    arguments[2] = "rho=0.2,0.5"
    done = program("train", *arguments, "hydra.sweep.subdir=${hydra.job.num}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr  # what failed before is forgotten


def test_a_ready_sweep_over_tasks_needs_a_directory(tmp_path: Path) -> None:
    done = program("train", "-m", "+experiment=rho", "task=parkour,dive", "hydra/launcher=basic", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "ogmp-train: for several tasks give a directory too: hydra.sweep.dir=<directory>.\n"


def test_a_task_file_of_the_users_own_works_by_path_and_by_directory(tmp_path: Path) -> None:
    source = ROOT / "tasks" / "stairs.yaml"
    (tmp_path / "mine" / "task").mkdir(parents=True)
    for name in ("hill", "slope"):
        shutil.copy(source, tmp_path / "mine" / "task" / f"{name}.yaml")
    for name, arguments in (("hill", ["task=mine/task/hill.yaml"]), ("slope", ["task=slope", "--config-dir", "mine"])):
        done = program("train", *arguments, "total_timesteps=128", *SMALL, f"hydra.run.dir={name}", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert load_policy(tmp_path / name).task.name == name


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["task=parkour", "rho=-1"], "'rho' must be above 0"),
        (["task=parkour", "oracle=previw"], "Did you mean 'preview'"),
        (["task=parkour", "num_envs=0"], "'num_envs' must be at least 1"),
        (["task=parkour", "seed=-1"], "'seed' must be at least 0"),
        (["task=parkour", "task.modes.jump.h=[0.3,0.1]"], "'modes.jump.h' is a reversed range"),
        (["task=parkour", "torch_threads=many"], "'torch_threads' must be auto or a whole number"),
        (["task=nowhere.yaml"], "nowhere.yaml: no such file"),
        (["task=parcour"], "parkour"),
        (["resume=nowhere"], "'nowhere' is no run directory."),
        (["resume=latest"], "'latest': no run is below 'runs' here yet."),
        (["resume=parkour"], "'parkour' is a policy that ships: there is no training to go on with."),
    ],
)
def test_a_users_mistake_is_a_sentence_without_a_traceback(arguments, sentence, tmp_path: Path) -> None:
    done = program("train", *arguments, "hydra.run.dir=run" if "resume" not in arguments[0] else "", cwd=tmp_path)
    assert done.returncode != 0
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("resumed", [False, True])
def test_a_tracker_whose_library_is_missing_is_a_sentence_before_anything_is_written(
    resumed: bool, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None if name == "wandb" else find(name))
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*") if path.name != "train.log"}
    what = [f"resume={run}", "total_timesteps=9999"] if resumed else ["task=dive"]
    done = program("train", *what, "logger=[tensorboard,wandb]", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        "ogmp-train: 'logger' is wandb, whose package is missing: pip install \"ogmp_sb3[wandb]\".\n"
    )
    assert not list(tmp_path.iterdir())
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_a_tracker_that_cannot_begin_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Unreachable:
        def begin(self, *_: object) -> None:
            raise ConnectionError("no route to host")

    monkeypatch.setitem(RUNS, "wandb", Unreachable)
    monkeypatch.setattr("ogmp_sb3.runs.training.check_installed", lambda names: None)
    monkeypatch.setattr("ogmp_sb3.commands.train.jobs.check_installed", lambda names: None)
    done = program("train", "task=dive", *SMALL, "logger=wandb", cwd=tmp_path)
    assert done.returncode == 2
    assert "'logger': wandb could not begin a run (no route to host). To train without it: logger=null" in done.stderr
    assert not list(tmp_path.iterdir())


def test_two_tasks_of_one_name_are_refused(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copy(TASKS_DIR / "dive.yaml", tmp_path / folder / "mine.yaml")
    done = program("train", "-m", "task=a/mine.yaml,b/mine.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert "'a/mine.yaml' and 'b/mine.yaml' are both called 'mine': rename one of the files." in done.stderr
    shutil.copy(TASKS_DIR / "dive.yaml", tmp_path / "dive.yaml")
    done = program("train", "-m", "task=dive,./dive.yaml", cwd=tmp_path)
    assert "'dive' and './dive.yaml' are both called 'dive'" in done.stderr


def test_eval_reports_every_metric_with_its_interval(run: Path, tmp_path: Path) -> None:
    done = program("eval", f"run={run}", "episodes=6", f"out={tmp_path}", "oracle=lqr", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "metrics.json").read_text())
    wanted = {"max_heading_acceleration_g", "max_heading_speed_mps", "max_froude", "episode_length_fraction"}
    wanted |= {"no_fall_fraction", "distance_m", "return", "surrogate_objective", "true_objective", "speed_error_mps"}
    assert set(report["metrics"]) == wanted
    for summary in report["metrics"].values():
        assert summary["n"] == 6
        assert summary["ci95"][0] <= summary["mean"] <= summary["ci95"][1]
    assert sum(report["terminations"].values()) == 6
    assert "distance_m" in done.stdout


def test_eval_over_a_grid_writes_cells_and_a_picture(run: Path, tmp_path: Path) -> None:
    grid = "grid=leap.w:0.1:0.3:2,leap.d:0.4:0.5:2"
    quick = ["episodes=3", "evaluation.episode_steps=20"]
    done = program("eval", f"run={run}", grid, f"out={tmp_path}", *quick, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "grid.json").read_text())["grid"]
    assert not (tmp_path / "metrics.json").exists()
    assert [(cell["w"], cell["d"]) for cell in report["cells"]] == [
        ([0.1, 0.2], [0.4, 0.45]), ([0.1, 0.2], [0.45, 0.5]), ([0.2, 0.3], [0.4, 0.45]), ([0.2, 0.3], [0.45, 0.5]),
    ]  # fmt: skip
    assert report["trained"]["w"] == [0.2, 0.35]
    assert {cell["metrics"]["return"]["n"] for cell in report["cells"]} == {3}
    assert (tmp_path / "grid.png").stat().st_size > 5000


def test_an_endless_evaluation_ends_at_the_distance_or_by_a_fall(run: Path, tmp_path: Path) -> None:
    arguments = ["protocol=endless", "max_distance=0.05", "episodes=4", f"out={tmp_path}"]
    done = program("eval", f"run={run}", *arguments, "evaluation.terminations.fall=null", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "metrics.json").read_text())
    assert set(report["terminations"]) <= {"max_distance", "time_limit"} and report["terminations"]["max_distance"]
    assert "episode_length_fraction" not in report["metrics"]
    assert report["metrics"]["distance_m"]["mean"] < 0.2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run=nowhere"], "'nowhere' is neither a run directory nor a shipped policy"),
        (["episodes=3"], "'run' is missing"),
        (["run={run}", "modes.jmp.h=1"], "unknown mode 'jmp'"),
        (["run={run}", "grid=jump.w"], "'grid' needs two parameters of one mode"),
        (["run={run}", "grid=jump.q,jump.h", "out=x"], "no number 'q'"),
        (["run=dive", "protocol=endless"], "'protocol=endless' is for tracks: the modes of 'dive' take a time"),
        (["run={run}", "scene=pace_to_jump", "grid=jump.w,jump.h"], "the sequence of modes says"),
    ],
)
def test_eval_mistakes_are_a_sentence(arguments, sentence, run: Path, tmp_path: Path) -> None:
    done = program("eval", *(a.format(run=run) for a in arguments), cwd=tmp_path)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scene", ["pace_to_jump", "pace_leap_pace", "faster"])
def test_eval_plays_every_shipped_scene(scene: str, run: Path, tmp_path: Path) -> None:
    arguments = [f"run={run}", f"scene={scene}", "episodes=2", f"out={tmp_path}", "evaluation.episode_steps=20"]
    done = program("eval", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "metrics.json").read_text())["scene"] == scene


def test_eval_of_an_unknown_scene_is_a_sentence(run: Path, tmp_path: Path) -> None:
    done = program("eval", f"run={run}", "scene=pace_to_jmp", cwd=tmp_path)
    assert done.returncode == 2
    assert "unknown scene 'pace_to_jmp'" in done.stderr and "Did you mean 'pace_to_jump'" in done.stderr


def test_observation_variants_of_the_paper_train_as_one_multirun(tmp_path: Path) -> None:
    variants = ["{clock:null,height_scan:null}", "{height_scan:null}", "{clock:null,mode_latent:null}"]
    variants += ["{mode_latent:null}", "{clock:null}", "{}"]
    sweep = f"task.observations={','.join(variants)}"
    done = program(
        "train", "-m", "task=parkour", sweep, "total_timesteps=128", *SMALL, "hydra.sweep.dir=sweep",
        "hydra.sweep.subdir=${hydra.job.num}", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    sizes = [len(load_policy(p).info["network"]["scale"]) for p in sorted((tmp_path / "sweep").iterdir()) if p.is_dir()]
    assert sizes == [33, 35, 56, 58, 58, 60]


def test_encode_writes_an_encoder_found_by_name(tmp_path: Path) -> None:
    with umask(UMASK):
        done = program("encode", "task=dive", "references=10", "updates=20", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "of the variance is not explained" in done.stdout
    folder = tmp_path / "encoders" / "dive"
    assert {"encoder.json", "encoder.safetensors", "latents.png"} <= {p.name for p in folder.iterdir()}
    assert {p.stat().st_mode & 0o777 for p in folder.iterdir()} == {0o666 & ~UMASK}


def test_check_validates_lists_and_draws(tmp_path: Path) -> None:
    done = program("check", "dive", f"out={tmp_path}", "randomisation.mass.scale=[0.9,1.1]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "preview" in done.stdout and "flip" in done.stdout
    assert "mass (scale 0.9..1.1)" in done.stdout
    assert (tmp_path / "references.png").stat().st_size > 5000
