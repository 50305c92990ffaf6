"""What a training counts and shows as it goes."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.runs.callbacks import EpisodeStatistics, Pace, ProgressBar, pace_text, progress_bar, steps_bar


class Logged:
    """A model that only keeps what is logged, on two environments with rollouts of four steps."""

    n_steps, n_envs = 4, 2

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.present: dict[str, float] = {}
        self.logger = SimpleNamespace(record=self.present.__setitem__)
        self.num_timesteps = 0
        self.ep_info_buffer: list[dict[str, float]] = []

    def dump_logs(self) -> None:
        self.rows.append(dict(self.present))
        self.present.clear()


def statistics(every: int = 8) -> tuple[EpisodeStatistics, Any]:
    callback, model = EpisodeStatistics(every), Logged()
    callback.model = model  # type: ignore[assignment]
    return callback, model


def ends(callback: EpisodeStatistics, *infos: dict[str, Any]) -> None:
    callback.locals = {"dones": np.ones(len(infos), dtype=bool), "infos": list(infos)}
    assert callback._on_step()


def episode(r: float, termination: str = "fall") -> dict[str, Any]:
    return {"episode": {"r": r, "l": 10, "t": 1.0}, "termination": termination}


def restart(survived: bool) -> dict[str, Any]:
    return {"restart": {}, "termination": "fall", "TimeLimit.truncated": survived}


def rollout_ends(callback: EpisodeStatistics, model: Any, samples: int) -> None:
    callback.num_timesteps = samples
    callback._on_rollout_end()


def test_a_row_has_the_means_of_the_episodes_since_the_last_and_their_causes() -> None:
    callback, model = statistics()
    ends(callback, episode(2.0), episode(4.0, "bound"))
    ends(callback, episode(6.0), restart(survived=True))
    rollout_ends(callback, model, 8)
    (row,) = model.rows
    assert row["episode/return"] == 4.0 and row["episode/length"] == 10.0
    assert row["termination/fall"] == pytest.approx(2 / 3) and row["termination/bound"] == pytest.approx(1 / 3)
    assert row["restart/share"] == 0.25 and row["restart/survived"] == 1.0
    assert "episode/t" not in row
    ends(callback, episode(1.0))
    rollout_ends(callback, model, 16)
    assert model.rows[1]["episode/return"] == 1.0


def test_rows_are_written_where_the_samples_pass_a_multiple() -> None:
    callback, model = statistics(every=20)
    for samples in range(8, 81, 8):
        ends(callback, episode(float(samples)))
        rollout_ends(callback, model, samples)
    assert len(model.rows) == 4
    assert model.rows[0]["episode/return"] == np.mean([8, 16, 24])


def test_counts_that_were_put_back_go_on() -> None:
    callback, model = statistics()
    ends(callback, episode(2.0), restart(survived=False))
    other, same = statistics()
    other.set_plain(copy.deepcopy(callback.plain()))
    for each, logged in ((callback, model), (other, same)):
        ends(each, episode(4.0))
        rollout_ends(each, logged, 8)
    assert model.rows == same.rows


def test_a_bar_is_closed_also_where_the_training_did_not_end(capsys: pytest.CaptureFixture[str]) -> None:
    bar = ProgressBar(100)
    bar.close()  # before it began
    bar.model = SimpleNamespace(ep_info_buffer=[])  # type: ignore[assignment]
    bar._on_training_start()
    bar.close()
    assert capsys.readouterr().err.endswith("\n")


def test_a_bar_counts_from_where_a_run_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(100, "sample", done=40) as bar:
        bar.update(10)
    assert "50.0/100" in capsys.readouterr().err


def test_the_time_left_of_episodes_is_by_the_mean_pace_so_far(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    with steps_bar(1000, "heat maps") as bar:
        for seconds, steps in ((10.0, 100), (10.0, 100), (12.0, 300)):  # an episode has ended early
            now[0] += seconds
            bar.update(steps)
        bar.refresh()
        assert "heat maps:  50%" in (shown := capsys.readouterr().err.split("\r")[-1])
        assert "500/1.00k control steps [00:32<00:32]" in shown
        bar.update(500)
    assert "100%" in capsys.readouterr().err


def test_there_is_no_bar_where_nothing_is_played(capsys: pytest.CaptureFixture[str]) -> None:
    with steps_bar(0, "evaluation"):
        pass
    assert capsys.readouterr().err == ""


def test_the_rest_of_a_training_is_estimated_once_without_its_first_update(monkeypatch, capsys) -> None:
    clock = [0.0]
    monkeypatch.setattr("ogmp_sb3.runs.callbacks.time.monotonic", lambda: clock[0])
    pace = Pace(total=10_000_000)
    said = []
    for samples in range(0, 400_000, 10_000):
        pace.num_timesteps = 50_000 + samples  # of a run that goes on
        pace._on_rollout_start()
        said.append(capsys.readouterr().out)
        clock[0] += 100.0 if samples == 0 else 5.0  # the first update compiles
    (text,) = filter(None, said)
    assert said.index(text) == 7  # the first update, then six of five seconds each
    remaining = 10_000_000 - 50_000 - 70_000
    assert text == f"2,000 samples/s so far: about 1 h 22 min for the other {remaining:,}, if the pace stays so.\n"
    assert round(remaining / 2000 / 60) == 82


@pytest.mark.parametrize(
    ("pace", "remaining", "text"),
    [(1000.0, 20_000, "about a minute"), (1000.0, 120_000, "about 2 min"), (1000.0, 3_600_000, "about 1 h 00 min")],
)
def test_the_time_left_is_in_hours_and_minutes(pace: float, remaining: int, text: str) -> None:
    assert text in pace_text(pace, remaining)


def test_a_training_of_seconds_says_no_time(capsys) -> None:
    pace = Pace(total=100)
    for _ in range(5):
        pace._on_rollout_start()
    assert capsys.readouterr().out == ""
