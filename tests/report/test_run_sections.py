"""The sections of a report on one run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.statistics import Estimate, estimate
from ogmp_sb3.evaluation.traces import Trace
from ogmp_sb3.report import run_sections
from ogmp_sb3.report.page import Table, Video

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
    subject = SimpleNamespace(
        task=PARKOUR, evaluation=lambda episodes, seed, progress: found, evaluation_steps=lambda episodes, seed: 0
    )
    section = run_sections.evaluation(subject, 16, 0, tmp_path)  # type: ignore[arg-type]
    assert section.text.endswith("12 of 16 episodes are copies of others and count once.")


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
