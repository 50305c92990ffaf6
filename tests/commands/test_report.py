"""ogmp-report on a tiny run and a tiny sweep, as a user runs it."""

from __future__ import annotations

import base64
import csv
import json
import re
import shutil
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from helpers.faults import read_only
from helpers.programs import SMALL, program
from ogmp_sb3.commands.report import run_folders
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation import grid
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.grid import default_grids
from ogmp_sb3.evaluation.metrics import highest_return
from ogmp_sb3.report.heat_maps import NOT_YET
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import default_out, owner

QUICK = ["episodes=3", "evaluation.episode_steps=20"]
FEW = ["grids=false", "variants=null", "traces=1", "film=false", "replay=null"]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Path:
    """Two jobs that finished; four were asked for."""
    folder = tmp_path_factory.mktemp("report")
    arguments = ["-m", "task=parkour", "rho=0.3,0.5", "total_timesteps=512", "hydra.sweep.subdir=${hydra.job.num}"]
    done = program("train", *arguments, *SMALL, "hydra.sweep.dir=sweep", cwd=folder)
    assert done.returncode == 0, done.stderr
    multirun = folder / "sweep" / "multirun.yaml"
    multirun.write_text(multirun.read_text().replace("rho=0.3,0.5", "rho=0.3,0.5,0.8,null"))
    return folder / "sweep"


@pytest.fixture(scope="module")
def run_page(sweep: Path) -> Path:
    (sweep / "0" / "run.mp4").write_bytes(b"not really a film")
    grids = ["grid_cells=3", "cell_episodes=1", "modes.pace.v=0.8"]
    done = program("report", f"run={sweep / '0'}", *QUICK, *grids, "traces=2", cwd=sweep)
    assert done.returncode == 0, done.stderr
    return sweep / "0" / "report"


@pytest.fixture(scope="module")
def sweep_page(sweep: Path) -> Path:
    done = program("report", f"sweep={sweep}", "out=page", *QUICK, cwd=sweep)
    assert done.returncode == 0, done.stderr
    return sweep / "page"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_page_needs_nothing_else_and_every_picture_can_be_seen(run_page: Path, sweep_page: Path) -> None:
    for folder in (run_page, sweep_page):
        html = (folder / "report.html").read_text(encoding="utf-8")
        sources, links = re.findall(r'\ssrc="([^"]*)"', html), re.findall(r'\shref="([^"]*)"', html)
        assert sources and all(source.startswith("data:") for source in sources)
        assert all(link.startswith("#") or (folder / link).is_file() for link in links)
        assert "<script" not in html and "@import" not in html and "url(" not in html
        pictures = [source for source in sources if source.startswith("data:image/svg+xml;base64,")]
        for source in pictures:
            assert ElementTree.fromstring(base64.b64decode(source.partition(",")[2])).tag.endswith("svg")
        files = sorted(path.stem for path in folder.glob("*.svg"))
        assert len(files) == len(pictures)
        others = [source.partition(";")[0] for source in sources if source not in pictures]
        assert set(others) <= ({"data:image/png", "data:video/mp4"} if folder is run_page else set())
        for stem in files:
            with Image.open(folder / f"{stem}.png") as image:
                image.verify()
            assert rows(folder / f"{stem}.csv")


def test_the_page_of_a_run_says_what_was_trained(run_page: Path) -> None:
    html = (run_page / "report.html").read_text(encoding="utf-8")
    for text in ("rho=0.3", "preview", "30 control steps", "deviates by 0.52 to 1.56", "mujoco", "512", "run.mp4"):
        assert text in html
    titles = re.findall(r"<h2>(.*?)</h2>", html)
    assert titles == ["Run", "Training", "Evaluation", "Falls", "Motion", "Mode parameters", "Mode latent", "Video"]


def test_a_page_begins_with_the_robot_and_three_numbers(opengl, run_page: Path) -> None:
    html = (run_page / "report.html").read_text(encoding="utf-8")
    head = html[: html.index("<h2>")]
    (strip,) = re.findall(r'<img src="data:image/png;base64,([^"]*)"', head)
    assert base64.b64decode(strip) == (run_page / "film.png").read_bytes()
    with Image.open(run_page / "film.png") as image:
        assert image.width > image.height and np.ptp(np.asarray(image.convert("L"))) > 100
    (inner,) = re.findall(r'<iframe srcdoc="([^"]*)"', head)
    assert unescape(inner) == (run_page / "replay.html").read_text(encoding="utf-8")
    labels = re.findall(r"<strong>(.*?)</strong>", head)
    assert labels == ["track displacement", "without a fall", "return"]
    metrics = {row["metric"]: row for row in rows(run_page / "metrics.csv") if row["group"] == "all"}
    shown = [float(value.split()[0]) for value in re.findall(r"<b>([\d.-]+)", head)]
    expected = [float(metrics[name]["mean"]) for name in ("true_objective", "no_fall_fraction", "return")]
    assert shown == pytest.approx([expected[0], 100 * expected[1], expected[2]], abs=0.06)


def test_the_curves_are_those_of_progress_csv(run_page: Path) -> None:
    logged, drawn = rows(run_page.parent / "progress.csv"), rows(run_page / "training.csv")
    assert len(drawn) == len(logged) > 3
    for column in drawn[0]:
        assert [row[column] and float(row[column]) for row in drawn] == [
            row[column] and float(row[column]) for row in logged
        ]
    assert {"time/total_timesteps", "episode/return", "episode/deviation"} <= set(drawn[0])


def test_the_evaluation_is_that_of_ogmp_eval(run_page: Path, tmp_path: Path) -> None:
    arguments = [f"run={run_page.parent}", *QUICK, "modes.pace.v=0.8", f"out={tmp_path}"]
    assert program("eval", *arguments, cwd=tmp_path).returncode == 0
    expected = json.loads((tmp_path / "metrics.json").read_text())
    for row in rows(run_page / "metrics.csv"):
        summary = expected["metrics"][row["metric"]]
        found = [float(row[name]) if row[name] else None for name in ("mean", "low", "high")]
        assert found == [summary["mean"], *summary["ci95"]]
    causes = {row["cause"]: int(row["episodes"]) for row in rows(run_page / "terminations.csv")}
    assert causes == expected["terminations"]


def test_heat_maps_know_which_cells_were_trained_on(run_page: Path) -> None:
    cells = rows(run_page / "grids.csv")
    assert [cell["mode"] for cell in cells] == ["jump"] * 9 + ["leap"] * 9
    assert [cell["trained"] for cell in cells] == 2 * (["False"] * 4 + ["True"] + ["False"] * 4)  # the middle of 3 x 3


def test_traces_are_of_fixed_seeds_and_variants_of_the_same_policy(run_page: Path) -> None:
    assert {row["trace"].split(",")[0] for row in rows(run_page / "traces.csv")} == {"seed 0", "seed 1"}
    queries = {}
    for row in rows(run_page / "traces_horizon.csv"):
        horizon = int(row["trace"].split(",")[0].removeprefix("horizon = "))
        queries.setdefault(horizon, []).append(int(row["query"]))
    assert sorted(queries) == [7, 15, 30]
    for horizon, numbers in queries.items():
        assert max(np.bincount(numbers)) <= horizon
    bound = [row for row in rows(run_page / "traces_rho.csv") if row["trace"].startswith("rho = 0.1")]
    assert all(float(row["deviation"]) <= 0.1 for row in bound[:-1])


def test_a_run_that_can_only_be_read_has_its_report_elsewhere(sweep: Path, tmp_path: Path) -> None:
    arguments = [
        f"run={sweep / '1'}",
        "episodes=1",
        "evaluation.episode_steps=5",
        "grids=false",
        "variants=null",
        "film=false",
    ]
    with read_only(sweep):
        done = program("report", *arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert f"'{sweep / '1' / 'report'}': nothing can be saved there (" in done.stderr
        assert "Permission denied). Give another directory: out=<directory>." in done.stderr
        for target in (f"run={sweep / '1'}", f"sweep={sweep}"):
            of_one = arguments[3:4] if target.startswith("run") else []
            out = target.partition("=")[0]
            done = program(
                "report",
                target,
                *arguments[1:3],
                *of_one,
                arguments[4],
                *(arguments[5:] if of_one else []),
                f"out={out}",
                cwd=tmp_path,
            )
            assert done.returncode == 0, done.stderr
            assert (tmp_path / out / "report.html").is_file()
            assert (tmp_path / out / "evaluation" / "results.jsonl").read_text().count('"settings"') == {
                "run": 1, "sweep": 2}[out]  # fmt: skip


def test_a_second_report_plays_no_episode_again(run_page: Path, monkeypatch) -> None:
    def fail(*arguments: object, **named: object) -> None:
        raise AssertionError("played again")

    monkeypatch.setattr("ogmp_sb3.evaluation.evaluated_policy.evaluate", fail)
    subject = EvaluatedPolicy(load_policy(run_page.parent), [QUICK[1], "modes.pace.v=0.8"], run_page.parent)
    causes = subject.evaluation(3, 0, fail).terminations
    assert sum(causes.values()) == 3
    grids = default_grids(subject.task, subject.loaded.task, 3)
    assert [len(grid["cells"]) for grid in subject.grids(grids, 1, 0, fail)] == [9, 9]
    with pytest.raises(AssertionError, match="played again"):
        subject.evaluation(4, 0, fail)


def test_the_page_is_there_before_its_heat_maps_and_stays_if_they_are_interrupted(
    sweep: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(sweep / "0" / "best", tmp_path / "mine")
    cells = ["grid_cells=1", "cell_episodes=2", "modes.pace.v=0.8"]
    quick = ["episodes=1", "evaluation.episode_steps=5", "variants=null", "traces=1", "film=false", "replay=null"]
    arguments = ["run=mine", *quick, *cells]
    page = tmp_path / "mine" / "report" / "report.html"
    play_sets = grid.play_sets

    def interrupted(*given: Any, **named: Any) -> Iterator[Any]:
        yield next(play_sets(*given, **named))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(grid, "play_sets", interrupted)
        stopped = program("report", *arguments, cwd=tmp_path)
    assert (stopped.returncode, stopped.stdout) == (130, "")
    assert f"{page} has everything but the heat maps, which are measured now." in stopped.stderr
    first = page.read_text(encoding="utf-8")
    titles = ["Run", "Evaluation", "Motion", "Mode parameters", "Mode latent"]
    assert re.findall(r"<h2>(.*?)</h2>", first) == titles
    assert NOT_YET in first and not (page.parent / "grids.csv").exists()
    assert (tmp_path / "mine" / "evaluation" / "results.jsonl").read_text().count('"cell"') == 1
    done = program("report", *arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout.split()) == (0, [str(page)])
    whole = page.read_text(encoding="utf-8")
    assert re.findall(r"<h2>(.*?)</h2>", whole) == titles
    assert NOT_YET not in whole and "grids.csv" in whole
    assert (tmp_path / "mine" / "evaluation" / "results.jsonl").read_text().count('"cell"') == 2
    assert [path for path in page.parent.iterdir() if path.name.startswith(".")] == []
    assert "everything but" not in program("report", *arguments, cwd=tmp_path).stderr


def test_pages_lie_with_the_run_and_those_of_two_policies_never_meet(tmp_path: Path) -> None:
    name = "parkour"
    for run in ("first", "second"):
        for policy in ("best", "checkpoints/000000000512"):
            (tmp_path / run / policy).mkdir(parents=True)
        (tmp_path / run / "config.yaml").write_text("")
        assert default_out(str(tmp_path / run), name, "report") == tmp_path / run / "report"
        for policy in ("best", "checkpoints/000000000512"):
            assert default_out(str(tmp_path / run / policy), name, "report") == tmp_path / run / "report" / policy
            assert owner(str(tmp_path / run / policy)) == tmp_path / run
    assert default_out("parkour", name, "report") == Path("report/parkour")


def test_the_best_policy_has_a_page_of_its_own_with_the_curves_of_its_run(sweep: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(sweep / "1", tmp_path / "mine", ignore=shutil.ignore_patterns("report"))
    done = program("report", "run=mine/best", *QUICK, *FEW, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(copy / "report" / "best" / "report.html")]
    html = (copy / "report" / "best" / "report.html").read_text()
    assert "Training" in re.findall(r"<h2>(.*?)</h2>", html) and "<title>mine" in html


def test_a_policy_without_its_run_has_a_page_of_its_own(sweep: Path, tmp_path: Path) -> None:
    shutil.copytree(sweep / "0" / "best", tmp_path / "mine")
    done = program("report", "run=mine", *QUICK, *FEW, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert "Training" not in re.findall(r"<h2>(.*?)</h2>", (tmp_path / "mine" / "report" / "report.html").read_text())


def test_a_sweep_with_missing_jobs_has_a_page_that_lists_them(sweep_page: Path) -> None:
    html = (sweep_page / "report.html").read_text(encoding="utf-8")
    assert "2 finished, 2 missing" in html
    captions = re.findall("<figcaption>([^<]*)", html)  # of the curves, the objectives, the ends and the traces
    assert ["deviates by 0.52 to 1.56" in text for text in captions] == [True, True, False, False]
    for value in ("0.3", "0.5", "0.8", "null"):
        assert f'<th scope="row">rho={value}</th>' in html
    assert {row["line"] for row in rows(sweep_page / "training.csv")} == {"0.3", "0.5"}
    first = [float(row["mean"]) for row in rows(sweep_page / "training.csv") if row["line"] == "0.3"]
    logged = [float(row["episode/return"]) for row in rows(sweep_page.parent / "0" / "progress.csv")]
    assert first == logged


def test_objectives_have_their_intervals(sweep_page: Path) -> None:
    found = rows(sweep_page / "objectives.csv")
    assert [(row["objective"], row["value"]) for row in found] == [
        (name, value) for name in ("surrogate: return", "true objective") for value in ("0.3", "0.5")
    ]
    metrics = {(row["group"], row["metric"]): row for row in rows(sweep_page / "metrics.csv")}
    for row, metric in zip(found, ["return", "return", "true_objective", "true_objective"], strict=True):
        expected = metrics[f"rho={row['value']}", metric]
        assert [row[key] for key in ("mean", "low", "high")] == [expected[key] for key in ("mean", "low", "high")]


def test_every_job_has_a_bar_of_what_ended_its_episodes(sweep_page: Path) -> None:
    ended = rows(sweep_page / "terminations.csv")
    for job in ("rho=0.3", "rho=0.5"):
        assert sum(int(row["episodes"]) for row in ended if row["job"] == job) == 3


def test_no_episode_beats_the_highest_return_of_its_steps(run_page: Path) -> None:
    for row in rows(run_page / "metrics.csv"):
        if row["metric"] == "return":
            assert float(row["mean"]) <= 20 * highest_return(load_task("parkour")) / 400


def test_runs_that_differ_in_the_seed_alone_are_compared_as_one_group(sweep: Path, tmp_path: Path) -> None:
    ignore = shutil.ignore_patterns("page", "report", "evaluation")
    for seed, name in enumerate(("with,comma", "b")):
        config = shutil.copytree(sweep / "0", tmp_path / name, ignore=ignore) / "config.yaml"
        config.write_text(config.read_text().replace("seed: 0", f"seed: {seed}"))
    (tmp_path / "beside").mkdir()  # matches, and is no run
    done = program("report", 'runs=["with,comma", b*]', *QUICK, "variants=null", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "report/runs/report.html\n"
    html = (tmp_path / "report" / "runs" / "report.html").read_text(encoding="utf-8")
    assert re.findall(r"<h2>(.*?)</h2>", html) == ["Sweep", "Training", "Objectives", "Seeds", "Jobs", "Evaluation"]
    assert "2 seeds are few" in html and "2: 0, 1" in html
    found = {(row["metric"], row["interval"]): row for row in rows(tmp_path / "report" / "runs" / "seeds.csv")}
    assert {row["group"] for row in found.values()} == {"all runs"}
    assert (found["return", "over seeds"]["n"], found["return", "over episodes"]["n"]) == ("2", "6")
    by_seed = [row for row in rows(tmp_path / "report" / "runs" / "metrics.csv") if row["metric"] == "return"]
    assert [row["group"] for row in by_seed] == ["seed=0", "seed=1"]


def test_a_job_that_cannot_be_loaded_is_listed_with_the_reason(sweep: Path, tmp_path: Path) -> None:
    copy = tmp_path / "sweep"
    shutil.copytree(sweep, copy, ignore=shutil.ignore_patterns("page", "report", "evaluation"))
    for policy in (copy / "1").rglob("policy.json"):
        policy.write_text("{}")
    with pytest.warns(UserWarning, match="damaged or missing"):
        done = program("report", f"sweep={copy}", *QUICK, "variants=null", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "has no checkpoint to load" in (copy / "report" / "report.html").read_text()


def test_a_sweep_in_which_nothing_was_trained_has_a_page(tmp_path: Path) -> None:
    for name, rho in (("0", -1), ("1", 0.5)):
        (tmp_path / "sweep" / name / ".hydra").mkdir(parents=True)
        overrides = yaml.safe_dump(["task=parkour", f"rho={rho}"])
        (tmp_path / "sweep" / name / ".hydra" / "overrides.yaml").write_text(overrides)
    (tmp_path / "sweep" / "1" / "progress.csv").write_text("damaged")
    done = program("report", f"sweep={tmp_path / 'sweep'}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "sweep" / "report" / "report.html").read_text()
    assert re.findall(r"<h2>(.*?)</h2>", html) == ["Sweep", "Jobs"]
    assert "1/progress.csv: not readable as a log of numbers" in html


def test_runs_may_be_a_list_with_commas_a_pattern_or_one_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b1", "b2", "with,comma"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text("")
    expected = {
        "a, b1": ["a", "b1"], "a,b*": ["a", "b1", "b2"], "[a, b1]": ["a", "b1"], "with,comma": ["with,comma"],
        "with,*": ["with,comma"], "b*": ["b1", "b2"], "a": ["a"], '["with,comma", a]': ["with,comma", "a"],
    }  # fmt: skip
    assert {text: list(map(str, run_folders(text))) for text in expected} == expected
    with pytest.raises(ValueError, match=r"no directory of a run is .c.\. A directory with a comma"):
        run_folders("a,c")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["out=x"], "give either 'run' or 'sweep'"),
        (["run=a", "sweep=b"], "give either 'run' or 'sweep'"),
        (["run=nowhere"], "'nowhere' is neither a run directory nor a shipped policy"),
        (["sweep=nowhere"], "'nowhere': no such directory"),
        (["run={sweep}"], "is a multirun: give it as sweep="),
        (["sweep={sweep}/0"], "is one run, not a multirun: give it as run="),
        (["sweep={sweep}", "grids=false"], "'grids' is of a run: a report on a sweep does not use it"),
        (["run=a", "runs=b"], "give either 'run' or 'sweep', or 'runs' to compare some"),
        (["runs={sweep}", "endless=3"], "'endless' is of a run: a report on several runs does not use it"),
        (["runs=nowhere*"], "'runs': no directory of a run is 'nowhere"),
        (
            ["runs=[{sweep}/0, b]"],
            "'runs': no directory of a run is 'b'. A directory with a comma in its name is put in quotes",
        ),
        (["runs=[1, 2]"], "'runs' must be directories, a,b, or a pattern, found .1, 2."),
        (["run={sweep}/0", "max_distance=50"], "'max_distance' is of endless tracks: give 'endless'"),
        (["run={sweep}/0", "endless=0"], "'endless' must be at least 1, found 0"),
        (["run=dive", "endless=5"], "'endless' is for tracks: the modes of 'dive' take a time"),
        (["run={sweep}/0", "variants=oracel"], "unknown variant 'oracel'"),
        (["run={sweep}/0", "episodes=0"], "'episodes' must be at least 1"),
        (["run={sweep}/0", "modes.jmp.h=1", "out=x"], "unknown mode 'jmp'"),
        (["sweep={sweep}", "modes.jmp.h=1", "out=x"], "unknown mode 'jmp'"),
        (["run={sweep}/0", "policy=worst"], "Did you mean|allowed: best, latest"),
        (["run={sweep}/0", "policy=best"], "'policy' is of a sweep; of a run, give the policy itself: run=.*/0/best"),
        (["run={sweep}/0", "grid_cells=200"], "'grid_cells' must be at most 100, found 200"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], sentence: str, sweep: Path, tmp_path: Path) -> None:
    done = program("report", *(a.format(sweep=sweep) for a in arguments), cwd=tmp_path)
    assert done.returncode == 2
    assert re.search(sentence, done.stderr)
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
