"""Signals that stop a training: it saves first."""

from __future__ import annotations

import os
import pty
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import pytest
from stable_baselines3.common.callbacks import BaseCallback

from helpers.programs import SMALL, program
from ogmp_sb3.runs.callbacks import EpisodeStatistics
from ogmp_sb3.runs.checkpoint import latest_checkpoint
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.runs.signals import STOPPING, saved_first


class Saver:
    def __init__(self) -> None:
        self.stops: list[int] = []
        self.then: list[Callable[[], object]] = []

    def request_stop(self, signum: int, frame: FrameType | None) -> None:
        self.stops.append(signum)

    def request_save(self, then: Callable[[], object]) -> None:
        self.then.append(then)


@pytest.fixture(autouse=True)
def default_handlers() -> Iterator[None]:
    """As in a program of its own, whoever runs the tests."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    for number in STOPPING:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_every_signal_that_would_end_the_program_asks_it_to_stop() -> None:
    saver = Saver()
    before = [signal.getsignal(number) for number in STOPPING]
    with saved_first(saver):
        for number in STOPPING:
            os.kill(os.getpid(), number)
    assert saver.stops == list(STOPPING)
    assert [signal.getsignal(number) for number in STOPPING] == before


def test_a_signal_that_is_ignored_stays_so() -> None:
    saver = Saver()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does
    with saved_first(saver):
        os.kill(os.getpid(), signal.SIGHUP)
    assert not saver.stops and not saver.then


def test_a_signal_that_somebody_handles_is_handed_on_when_all_is_saved() -> None:
    saver, handled = Saver(), []
    signal.signal(signal.SIGUSR2, lambda signum, frame: handled.append(signum))  # as submitit does
    with saved_first(saver):
        os.kill(os.getpid(), signal.SIGUSR2)
        assert not handled and not saver.stops
        saver.then[0]()
    assert handled == [signal.SIGUSR2]


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2])
def test_a_training_saves_and_says_how_to_go_on(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EpisodeStatistics, "_on_rollout_end", lambda self: os.kill(os.getpid(), number))
    done = program("train", "task=dive", *SMALL, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 130, done.stderr
    assert f"Stopped at step 128. To go on:  ogmp-train resume={tmp_path / 'run'}" in done.stdout
    assert f"send {number.name} again to quit at once" in done.stderr
    assert int(latest_checkpoint(tmp_path / "run").name) == 128
    log = (tmp_path / "run" / "train.log").read_text()
    assert "Stopping after this update" in log and "Stopped at step 128" in log


def test_a_training_whose_signal_is_anothers_saves_hands_on_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[list[str]] = []

    def put_into_the_queue(signum: int, frame: FrameType | None) -> None:
        saved.append([folder.name for folder in checkpoint_dirs(tmp_path / "run")])

    def at_the_second(self: BaseCallback) -> None:
        if self.num_timesteps == 256:
            os.kill(os.getpid(), signal.SIGUSR2)

    signal.signal(signal.SIGUSR2, put_into_the_queue)
    monkeypatch.setattr(EpisodeStatistics, "_on_rollout_end", at_the_second)
    words = ["task=dive", *SMALL, "hydra.run.dir=run", "total_timesteps=512", "checkpoint_interval=10000"]
    done = program("train", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert saved == [[f"{256:012d}"]]
    assert [int(folder.name) for folder in checkpoint_dirs(tmp_path / "run")] == [256, 512]


def test_a_training_whose_terminal_is_gone_saves(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ogmp_sb3.commands.train.program", "task=dive", *SMALL, "hydra.run.dir=run"]
    process, terminal = pty.fork()
    if process == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, command)
    deadline = time.monotonic() + 240
    while not (tmp_path / "run" / "progress.csv").is_file() and time.monotonic() < deadline:
        if select.select([terminal], [], [], 0.2)[0]:
            os.read(terminal, 4096)
    os.close(terminal)  # as when ssh is cut off: the kernel sends SIGHUP, and writing is an error
    _, status = os.waitpid(process, 0)
    assert os.waitstatus_to_exitcode(status) == 130
    assert "Stopped at step" in (tmp_path / "run" / "train.log").read_text()
    assert latest_checkpoint(tmp_path / "run").is_dir()
