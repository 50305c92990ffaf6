"""Jobs grouped by what they differ in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from ogmp_sb3.report.panels import brief, jobs_along, label_of, mean_curve, shown, sweep_of
from ogmp_sb3.runs.logs import STEP_COLUMN
from ogmp_sb3.runs.multirun import setting
from ogmp_sb3.runs.run_directory import Run


def job(log: dict[str, list[float]] | None = None, state: str = "finished", **settings: Any) -> Run:
    overrides = tuple(f"{key}={shown(value)}" for key, value in settings.items())
    columns = {key: np.array(values, dtype=float) for key, values in (log or {}).items()}
    return Run(Path("job"), overrides, {"task": settings} if state != "missing" else {}, columns, state)


def test_lines_differ_in_rho_panels_in_the_rest_and_seeds_share_a_line() -> None:
    jobs = [job(rho=r, oracle=o, seed=s) for o in ("lqr", "linear") for r in (None, 0.5, 0.3) for s in (0, 1)]
    sweep = sweep_of(jobs)
    assert sweep.line_key == "rho"
    assert [panel.title for panel in sweep.panels] == ["oracle=lqr", "oracle=linear"]
    for panel in sweep.panels:
        assert [(line.value, len(line.runs)) for line in panel.lines] == [(0.3, 2), (0.5, 2), (None, 2)]


@pytest.mark.parametrize(
    ("settings", "line_key"),
    [
        ([{"horizon": 7, "oracle": "lqr"}, {"horizon": 15, "oracle": "linear"}], "horizon"),
        ([{"oracle": "lqr", "num_envs": 16}, {"oracle": "linear", "num_envs": 32}], "num_envs"),
        ([{"oracle": "lqr"}, {"oracle": "linear"}], "oracle"),
        ([{"seed": 0}, {"seed": 1}], "seed"),
    ],
)
def test_without_rho_lines_differ_in_the_horizon_then_numbers_then_words(settings: list, line_key: str) -> None:
    assert sweep_of([job(**s) for s in settings]).line_key == line_key


def test_a_job_that_was_never_started_has_no_line() -> None:
    sweep = sweep_of([job(rho=0.3), job(rho=0.5, state="missing")])
    assert [line.value for line in sweep.panels[0].lines] == [0.3]
    assert len(sweep.jobs) == 2


def test_settings_are_shown_as_they_are_typed() -> None:
    assert label_of(job(rho=None, observations={"clock": None}), ["rho", "observations"]) == (
        "rho=null, observations={clock: null}"
    )


def test_words_stay_in_the_order_of_the_command_line() -> None:
    values: list[Any] = [{"clock": None, "height_scan": None}, {"clock": None}, {}]
    (panel,) = sweep_of([job(observations=value) for value in values]).panels
    assert [line.value for line in panel.lines] == values


def test_a_picture_says_of_a_mapping_what_it_changes() -> None:
    assert brief({"clock": None, "height_scan": None}) == "no clock, no height_scan"
    assert (brief({}), brief({"z": 1.0}), brief(None), brief(0.3)) == ("unchanged", "z: 1.0", "null", "0.3")


def test_jobs_along_a_key_differ_in_nothing_else() -> None:
    pairs = [("linear", 0.5), ("lqr", 0.3), ("lqr", None), ("preview", 0.1), ("preview", 0.3), ("lqr", 0.1)]
    jobs = [job(oracle=oracle, rho=rho, seed=seed) for oracle, rho in pairs for seed in (0, 1)]
    found = jobs_along("rho", jobs, ["oracle", "rho", "seed"], lambda job: [0.0])
    assert [(setting(j, "oracle"), setting(j, "rho"), setting(j, "seed")) for j in found] == [
        ("lqr", 0.1, 0), ("lqr", 0.3, 0), ("lqr", None, 0),
    ]  # fmt: skip
    assert jobs_along("rho", [], ["rho"], lambda job: [0.0]) == []


@pytest.mark.parametrize(("score", "rho"), [(1.0, 0.3), (-1.0, 0.1)])
def test_of_equally_large_groups_of_jobs_the_best_is_taken(score: float, rho: float) -> None:
    jobs = [job(oracle=oracle, rho=r) for r in (0.1, 0.3) for oracle in ("lqr", "preview")]
    jobs.append(job(oracle="lqr", rho=0.5))  # the best, and alone
    found = jobs_along("oracle", jobs, ["oracle", "rho"], lambda job: [0.0, score * setting(job, "rho")])
    assert [(setting(j, "oracle"), setting(j, "rho")) for j in found] == [("lqr", rho), ("preview", rho)]


def test_the_same_training_in_two_directories_counts_once() -> None:
    jobs = [job(rho=0.3, seed=0), job(rho=0.3, seed=0), job(rho=0.3, seed=1), job(rho=0.5, seed=0)]
    lines = sweep_of(jobs).panels[0].lines
    assert [[setting(run, "seed") for run in line.runs] for line in lines] == [[0, 1], [0]]


def test_the_curve_of_one_run_is_its_log() -> None:
    curve = mean_curve([job({STEP_COLUMN: [10, 20], "a": [1.0, 4.0]})], "a")
    np.testing.assert_array_equal(curve["samples"], [10, 20])
    np.testing.assert_array_equal(curve["mean"], [1.0, 4.0])
    np.testing.assert_array_equal(curve["seeds"], [1, 1])
    assert np.isnan([curve["low"], curve["high"]]).all()  # of one seed there is no interval over seeds


def test_the_curve_of_several_seeds_averages_those_that_have_got_so_far() -> None:
    first = job({STEP_COLUMN: [10, 20, 30], "a": [1.0, 2.0, 3.0]})
    second = job({STEP_COLUMN: [10, 25], "a": [3.0, 6.0]})  # 5 at 20
    late = job({STEP_COLUMN: [], "a": []})
    curve = mean_curve([second, first, late, job()], "a")
    np.testing.assert_array_equal(curve["samples"], [10, 20, 30])
    np.testing.assert_allclose(curve["mean"], [2.0, 3.5, 3.0])
    np.testing.assert_array_equal(curve["seeds"], [2, 2, 1])
    expected = [stats.ttest_1samp(values, 0.0).confidence_interval() for values in ([1.0, 3.0], [2.0, 5.0])]
    np.testing.assert_allclose(curve["low"], [*(each.low for each in expected), np.nan])
    np.testing.assert_allclose(curve["high"], [*(each.high for each in expected), np.nan])


def test_jobs_that_differ_in_the_seed_alone_are_one_line() -> None:
    sweep = sweep_of([job(rho=0.3, seed=seed) for seed in (2, 0, 1)])
    ((line,),) = (panel.lines for panel in sweep.panels)
    assert (sweep.keys, sweep.line_key, line.value, line.seeds) == (["seed"], "seed", "2, 0, 1", ["2", "0", "1"])


def test_without_a_log_there_is_no_curve() -> None:
    assert all(len(values) == 0 for values in mean_curve([job()], "a").values())
