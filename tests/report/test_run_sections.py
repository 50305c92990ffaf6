"""The sections of a report on one run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import Estimate, estimate
from ogmp_sb3.evaluation.traces import Trace
from ogmp_sb3.report import run_sections
from ogmp_sb3.report.page import Table, Video
from ogmp_sb3.runs.run_directory import Run

PARKOUR = load_task("parkour")


def test_every_metric_has_its_interval_and_its_meaning() -> None:
    metrics = {"no_fall_fraction": Estimate(0.5, 0.5, 8, 0.2, 0.8), "true_objective": estimate([3.0])}
    table = run_sections.metrics_table(PARKOUR, metrics)
    assert [row[:5] for row in table.rows] == [
        ["no_fall_fraction", "0.500", f"0.200{run_sections.THIN}…{run_sections.THIN}0.800", "0.500", "8"],
        ["true_objective", "3.000", "-", "-", "1"],
    ]
    assert "displacement along the track" in table.rows[1][-1]  # the objective of parkour


def test_a_file_of_metrics_has_a_row_for_each_group_and_metric() -> None:
    each = Estimate(1.0, 0.5, 4, 0.0, 2.0)
    rows = run_sections.metrics_rows([("all", {"return": each}), ("r=left", {"return": each, "distance_m": each})])
    assert [(row["group"], row["metric"]) for row in rows] == [
        ("all", "return"), ("r=left", "return"), ("r=left", "distance_m"),
    ]  # fmt: skip
    assert {key: rows[0][key] for key in ("mean", "low", "high", "std", "n")} == {
        "mean": 1.0, "low": 0.0, "high": 2.0, "std": 0.5, "n": 4,
    }  # fmt: skip


def test_mean_and_interval_fit_one_cell() -> None:
    assert run_sections.interval(Estimate(1.0, 0.5, 4, 0.25, 2.0)) == f"1.00 [0.25,{run_sections.THIN}2.00]"
    assert run_sections.interval(estimate([3.0])) == "3.00 [-]"


def test_the_evaluation_says_that_copies_count_once(tmp_path: Path) -> None:
    each = {"return": Estimate(1.0, 0.5, 4, 0.0, 2.0)}
    found = Evaluation(each, {}, 0.0, {"fall": 4}, copies=12)
    section = run_sections.evaluation(SimpleNamespace(task=PARKOUR), found, 0, tmp_path)  # type: ignore[arg-type]
    assert section.text.endswith("12 of 16 episodes are copies of others and count once.")


def test_a_run_says_when_where_for_how_long_and_by_which_command_it_was_trained() -> None:
    info = {"num_timesteps": 16_001_024, "versions": {"mujoco": "3.17.0"}}
    loaded = SimpleNamespace(task=PARKOUR, info=info, path=Path("run"))
    subject = SimpleNamespace(loaded=loaded, samples=16_001_024, overrides=[])
    began = {"date": "2026-01-31 12:00 UTC", "machine": "Fast 3000, 2 CPUs, Linux", "commit": "0123456789ab"}
    config = {"train": {"total_timesteps": 20_000_000}, "began": began}
    log = {"time/total_timesteps": np.array([1e6, 16e6]), "time/time_elapsed": np.array([60.0, 7260.0])}
    run = Run(Path("run"), ("task=parkour", "modes.jump.h=[0.2,0.3]"), config, log, "stopped")
    (table,) = run_sections.overview(subject, run).parts  # type: ignore[arg-type]
    assert isinstance(table, Table)
    told = {row[0]: row[1] for row in table.rows}
    assert told["samples"] == "16.0M; the run is stopped, with 16.0M of 20.0M"
    assert [told[key] for key in ("date", "machine", "commit")] == list(began.values())
    assert told["trained for"] == "2 h 01 min, 2,204 samples/s, pauses left out"
    assert told["command"] == "ogmp-train task=parkour 'modes.jump.h=[0.2,0.3]'"
    assert list(told)[-5:] == ["date", "trained for", "machine", "commit", "command"]


def test_a_run_of_before_that_was_recorded_says_what_there_is() -> None:
    loaded = SimpleNamespace(task=PARKOUR, info={}, path=Path("run"))
    subject = SimpleNamespace(loaded=loaded, samples=None, overrides=[])
    run = Run(Path("run"), (), {"train": {"total_timesteps": 100}}, {}, "failed")
    (table,) = run_sections.overview(subject, run).parts  # type: ignore[arg-type]
    assert isinstance(table, Table)
    assert not {"date", "trained for", "machine", "commit", "command"} & {row[0] for row in table.rows}


@pytest.mark.parametrize(("seconds", "text"), [(20.0, "0 min"), (3570.0, "1 h 00 min"), (59.0 * 60, "59 min")])
def test_a_time_is_in_hours_and_minutes(seconds: float, text: str) -> None:
    assert run_sections.duration(seconds) == text


def test_variants_are_told_from_what_was_trained_and_oracles_are_those_of_the_task(monkeypatch, tmp_path: Path) -> None:
    captions: dict[str, str] = {}
    played: list[str] = []

    class Asked:
        loaded = SimpleNamespace(task=load_task("parkour", {"rho": None}))
        task = replace(load_task("parkour", {"rho": 0.2, "oracle": "lqr"}), oracle_params={"mine": {}, "lqr": {}})

        def traces(self, episodes: int, seed: int, title: str = "", overrides: tuple[str, ...] = ()) -> list[Trace]:
            played.extend(overrides)
            return []

    def picture(out: Path, name: str, caption: str, traces: list[Trace]) -> Table:
        captions[name] = caption
        return Table([])

    monkeypatch.setattr(run_sections, "traces_picture", picture)
    run_sections.motion(Asked(), 1, 0, list(run_sections.VARIANTS), tmp_path)  # type: ignore[arg-type]
    assert played[:2] == ["oracle=mine", "oracle=lqr"]
    for key, value in (("oracle", "preview"), ("horizon", "30"), ("rho", "null")):
        assert f"trained with {key} = {value}," in captions[f"traces_{key}"]


def test_videos_are_in_the_page_unless_they_are_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_sections.videos(tmp_path) is None
    monkeypatch.setattr(run_sections, "LARGEST_VIDEO", 10)
    (tmp_path / "a.mp4").write_bytes(b"film")
    (tmp_path / "b.mp4").write_bytes(b"a longer film")
    small, large = run_sections.videos(tmp_path).parts
    assert isinstance(small, Video) and small.source.startswith("data:video/mp4;base64,")
    assert isinstance(large, Table) and "too large for the page" in large.rows[0][1]
