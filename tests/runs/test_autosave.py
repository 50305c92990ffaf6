"""A training keeps what it has, whenever it is killed and whatever the disk does."""

from __future__ import annotations

import logging
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.faults import NO_SPACE, hidden, killed_at
from helpers.learners import ROLLOUT, learner, policy_info, update
from helpers.programs import SMALL, program, progress
from ogmp_sb3.runs import autosave as saving
from ogmp_sb3.runs import checkpoint as checkpoints
from ogmp_sb3.runs import logs
from ogmp_sb3.runs.autosave import Checkpoints
from ogmp_sb3.runs.callbacks import EpisodeStatistics, UnstableSteps
from ogmp_sb3.runs.checkpoint import latest_checkpoint
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs, tidy_run
from ogmp_sb3.runs.settings import TrainConfig
from ogmp_sb3.runs.storage import verify
from ogmp_sb3.sb3.hyperparameters import default_ppo
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

KEPT = 2


def saver(model: RecurrentPPO, run_dir: Path, **settings: Any) -> Checkpoints:
    config = {"seed": 0, "total_timesteps": 10**6, "num_envs": 2, "checkpoint_interval": ROLLOUT, **settings}
    config = {"torch_threads": 1, "physics_threads": 1, "policy_average": None, "ppo": default_ppo(), **config}
    config = {"keep_checkpoints": KEPT, **config}
    made = Checkpoints(
        run_dir, TrainConfig(**config), policy_info(), EpisodeStatistics(ROLLOUT), UnstableSteps(run_dir, 0, {})
    )
    made.model = model
    return made


def returns(model: RecurrentPPO, value: float) -> None:
    """Have the last episodes come to a return."""
    model.ep_info_buffer.clear()
    model.ep_info_buffer.append({"r": value, "l": 3, "t": 0.1, "level": 1.0})


@pytest.fixture(scope="module")
def two_saved(tmp_path_factory) -> tuple[RecurrentPPO, Path]:
    """A run with two checkpoints, the first of which is the best."""
    run_dir = tmp_path_factory.mktemp("saved") / "run"
    model, callback = learner()
    made = saver(model, run_dir)
    for value in (2.0, 1.0):
        update(model, callback)
        returns(model, value)
        made.save()
    return model, run_dir


def test_checkpoints_are_kept_by_number_and_the_best_apart(two_saved, tmp_path: Path) -> None:
    model, saved = two_saved
    run_dir = shutil.copytree(saved, tmp_path / "run")
    assert [int(folder.name) for folder in checkpoint_dirs(run_dir)] == [ROLLOUT, 2 * ROLLOUT]
    assert load_policy(run_dir / "best").info["num_timesteps"] == ROLLOUT
    made = saver(model, run_dir)
    made.restore(latest_checkpoint(run_dir))
    assert (made.best, made.best_at) == ((1.0, 2.0), ROLLOUT)
    model.num_timesteps += ROLLOUT
    returns(model, 3.0)
    made.save()
    assert [int(folder.name) for folder in checkpoint_dirs(run_dir)] == [2 * ROLLOUT, 3 * ROLLOUT]
    assert load_policy(run_dir / "best").info["num_timesteps"] == 3 * ROLLOUT
    assert hidden(run_dir) == []


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [
        ((1.0, 5.0), (1.0, 6.0), True),
        ((1.0, 6.0), (1.0, 5.0), False),
        ((0.9, 200.0), (1.0, 160.0), True),  # the level counts first, whatever the returns are
        ((1.0, 160.0), (0.9, 200.0), False),
        ((0.52, 5.0), (0.48, 6.0), True),  # the same tenth
    ],
)
def test_the_best_policy_is_of_the_highest_level_and_then_of_the_highest_return(
    before: tuple[float, float], after: tuple[float, float], better: bool, two_saved, tmp_path: Path
) -> None:
    model, _ = two_saved
    made = saver(model, tmp_path / "run")
    for steps, (level, value) in enumerate((before, after), start=1):
        model.num_timesteps = steps
        model.ep_info_buffer.clear()
        model.ep_info_buffer.append({"r": value, "l": 3, "t": 0.1, "level": level})
        made.save()
    assert load_policy(tmp_path / "run" / "best").info["num_timesteps"] == (2 if better else 1)


def test_a_best_policy_that_could_not_be_copied_is_copied_with_the_next_checkpoint(
    two_saved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, _ = two_saved
    made = saver(model, tmp_path / "run")
    monkeypatch.setattr(saving, "copy_policy", failing(saving.copy_policy, {0}))
    made.tried_at = 0
    for steps, value in ((ROLLOUT, 9.0), (2 * ROLLOUT, 1.0)):
        model.num_timesteps = made.num_timesteps = steps
        returns(model, value)
        if steps == ROLLOUT:
            with pytest.warns(UserWarning, match=r"best: not written .*; the training goes on, the best policy is in"):
                made._on_rollout_start()
            assert not (tmp_path / "run" / "best").exists()
        else:
            made._on_rollout_start()
    assert load_policy(tmp_path / "run" / "best").info["num_timesteps"] == ROLLOUT


def test_a_checkpoint_that_is_there_is_not_written_again(two_saved, tmp_path: Path) -> None:
    model, saved = two_saved
    run_dir = shutil.copytree(saved, tmp_path / "run")
    made = saver(model, run_dir)
    made.restore(latest_checkpoint(run_dir))
    before = latest_checkpoint(run_dir).stat().st_mtime_ns
    made.save()
    assert latest_checkpoint(run_dir).stat().st_mtime_ns == before


def test_killed_at_any_access_while_saving_a_run_has_checkpoint_and_best(two_saved, tmp_path: Path) -> None:
    """The new checkpoint is the best, and the oldest one has to go: every kind of write in one."""
    model, saved = two_saved
    went_on = set()
    for access in range(200):
        run_dir = shutil.copytree(saved, tmp_path / str(access) / "run")
        made = saver(model, run_dir)
        made.restore(latest_checkpoint(run_dir))
        model.num_timesteps = 3 * ROLLOUT
        returns(model, 3.0)
        with killed_at(access, tmp_path) as killed:
            made.save()

        tidy_run(run_dir)
        assert hidden(run_dir) == []
        for folder in checkpoint_dirs(run_dir):
            verify(folder)
        assert len(checkpoint_dirs(run_dir)) >= KEPT
        again = saver(model, run_dir)
        again.restore(latest_checkpoint(run_dir))
        assert model.num_timesteps >= 2 * ROLLOUT
        went_on.add(model.num_timesteps)
        assert load_policy(run_dir / "best").info["num_timesteps"] == again.best_at
        shutil.rmtree(run_dir)
        if not killed[0]:
            break
    assert access > 40
    assert went_on == {2 * ROLLOUT, 3 * ROLLOUT}


def test_damaged_checkpoints_are_set_aside_and_never_push_whole_ones_out(two_saved, tmp_path: Path) -> None:
    model, saved = two_saved
    run_dir = shutil.copytree(saved, tmp_path / "run")
    (checkpoint_dirs(run_dir)[-1] / "trainer.json").write_text("{}")
    made = saver(model, run_dir, keep_checkpoints=1)
    with pytest.warns(UserWarning, match="trainer.json: damaged or missing.*Falling back"):
        made.restore(latest_checkpoint(run_dir))
    assert model.num_timesteps == ROLLOUT
    model.num_timesteps += 3  # not where the damaged one was
    made.save()
    assert [int(folder.name) for folder in checkpoint_dirs(run_dir)] == [ROLLOUT + 3]
    assert (run_dir / "checkpoints" / f"damaged-{2 * ROLLOUT:012d}").is_dir()


@pytest.mark.parametrize(
    "change", [{"sums": 3}, {"causes": {"fall": "x"}}, {"restarts": 2}, {"best": None}, {"best_at": "x"}, None]
)
def test_statistics_that_are_none_are_a_sentence(change, two_saved, tmp_path: Path, monkeypatch) -> None:
    model, saved = two_saved
    good = {"sums": {}, "causes": {}, "restarts": {}, "best": [1.0, 1.0]}
    monkeypatch.setattr("ogmp_sb3.runs.autosave.load_trainer", lambda *_: {**good, **change} if change else {})
    with pytest.raises(ValueError, match=r"trainer.json: 'statistics.(sums|causes|restarts|best)"):
        saver(model, saved).restore(latest_checkpoint(saved))


# ---- disks ----


def failing(function: Any, calls: set[int]) -> Any:
    """The function, but at these calls the disk is full."""
    count = iter(range(10**6))

    def wrapped(*args: Any, **kwargs: Any) -> Any:
        if next(count) in calls:
            raise NO_SPACE
        return function(*args, **kwargs)

    return wrapped


TINY = ["task=dive", *SMALL, "ppo.lstm_hidden_size=8", "total_timesteps=640", "checkpoint_interval=128"]


def test_a_training_goes_on_without_the_checkpoints_and_rows_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each checkpoint writes two files of tensors, the one that is tried at the start too.
    monkeypatch.setattr(checkpoints, "save_tensors", failing(checkpoints.save_tensors, {5, 6}))
    monkeypatch.setattr(logs.CsvWriter, "_append", failing(logs.CsvWriter._append, {0}))
    monkeypatch.setattr(logs.TensorBoardWriter, "_add", failing(logs.TensorBoardWriter._add, {4}))
    with pytest.warns(UserWarning) as caught:
        done = program("train", *TINY, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = [str(warning.message) for warning in caught]
    for end in (256, 384):
        (text,) = [text for text in said if f"{end:012d}: not written" in text]
        assert "(No space left on device); the training goes on, the last one is of step 128" in text
    assert len([text for text in said if "a row could not be written (No space left on device)" in text]) == 2
    run_dir = tmp_path / "run"
    assert [int(folder.name) for folder in checkpoint_dirs(run_dir)] == [128, 512, 640]
    assert progress(run_dir) == [128, 256, 384, 512, 640]
    assert len(list(run_dir.glob("events.*"))) == 2
    assert [path for path in hidden(run_dir) if path != ".hydra"] == []


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own, too small for anything."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if shutil.which("mount") is None or subprocess.run(mounted(folder, 128), check=False).returncode != 0:
        pytest.skip("no small disk can be mounted here: that needs root")
    yield folder
    let_go()
    subprocess.run(["umount", folder], check=True)


def let_go() -> None:
    """Close the log that Hydra leaves open in the run directory of a training in this process."""
    for handler in list(logging.getLogger().handlers):
        if isinstance(handler, logging.FileHandler):
            handler.close()
            logging.getLogger().removeHandler(handler)


def mounted(folder: Path, kilobytes: int, *more: str) -> list[str | Path]:
    return ["mount", "-t", "tmpfs", "-o", ",".join([f"size={kilobytes}k", *more]), "tmpfs", folder]


def test_a_full_disk_is_said_at_the_start_and_one_that_fills_up_costs_nothing_that_was_saved(disk: Path) -> None:
    run_dir = disk / "run"
    arguments = [*TINY, "keep_checkpoints=100", f"hydra.run.dir={run_dir}"]
    done = program("train", *arguments, cwd=disk)
    assert done.returncode == 2
    whole = f"the disk mounted at {disk} is full"
    assert done.stderr.startswith(f"ogmp-train: {run_dir}") and whole in done.stderr  # whatever is written first
    assert checkpoint_dirs(run_dir) == []

    subprocess.run(mounted(disk, 900, "remount"), check=True)  # enough for some of the checkpoints
    with pytest.warns(UserWarning, match=rf"not written \(No space left on device: {whole}\); the"):
        done = program("train", *arguments, cwd=disk)
    assert done.returncode == 2
    assert "Make room, then go on with: ogmp-train resume=" in done.stderr
    saved = [int(folder.name) for folder in checkpoint_dirs(run_dir)]
    assert saved and saved[-1] < 640
    for folder in checkpoint_dirs(run_dir):
        verify(folder)

    subprocess.run(mounted(disk, 20_000, "remount"), check=True)
    done = program("train", f"resume={run_dir}", cwd=disk)
    assert done.returncode == 0, done.stderr
    assert f"resumed at step {saved[-1]}" in done.stdout
    assert int(checkpoint_dirs(run_dir)[-1].name) == 640
    assert progress(run_dir) == [128, 256, 384, 512, 640]


def test_a_directory_that_cannot_be_written_is_said_at_the_start(disk: Path) -> None:
    run_dir = disk / "run"
    subprocess.run(mounted(disk, 20_000, "remount"), check=True)
    assert program("train", *TINY, f"hydra.run.dir={run_dir}", cwd=disk).returncode == 0
    let_go()
    subprocess.run(mounted(disk, 20_000, "remount", "ro"), check=True)
    done = program("train", f"resume={run_dir}", "total_timesteps=1280", cwd=disk)
    assert done.returncode == 2
    assert "Read-only file system" in done.stderr and str(run_dir) in done.stderr
    assert len(done.stderr.splitlines()) == 1
