"""What run= names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from helpers.run_directories import make_run
from ogmp_sb3.runs.run_names import find_run

NAMES = ("parkour/2026-11-01_12-00-00", "parkour/2026-11-02_12-00-00", "dive/2026-11-03_09-30-00", "first")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with four runs, the later ones in the list the newer, and a sweep older than all."""
    monkeypatch.chdir(tmp_path)
    for i, name in enumerate(NAMES):
        add(tmp_path / "runs" / name, 1000 + i)
    for i in (1, 2, 10):
        add(tmp_path / "runs" / "sweeps" / "2026-10-31_00-00-00" / f"num_envs=8,seed={i},task=dive", 10 + i)
    (tmp_path / "runs" / "sweeps" / "2026-10-31_00-00-00" / "multirun.yaml").touch()
    return tmp_path


def add(path: Path, begun: int, checkpoint: int = 256) -> None:
    make_run(path, ["task=dive"], checkpoint=checkpoint)
    os.utime(path / "config.yaml", (begun, begun))


SWEEP = "runs/sweeps/2026-10-31_00-00-00"


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("latest", "runs/first"),
        ("latest/best", "runs/first/best"),
        ("latest/checkpoints/000000000256", "runs/first/checkpoints/000000000256"),
        ("runs", "runs/first"),
        ("runs/parkour", "runs/parkour/2026-11-02_12-00-00"),
        ("runs/parkour/", "runs/parkour/2026-11-02_12-00-00"),
        ("runs/first", "runs/first"),  # a path stays as it was typed
        ("./runs/first/", "./runs/first/"),
        ("fir", "runs/first"),
        ("2026-11-03", "runs/dive/2026-11-03_09-30-00"),
        ("dive/2026", "runs/dive/2026-11-03_09-30-00"),
        ("runs/dive/2026-11", "runs/dive/2026-11-03_09-30-00"),
        ("dive/2026/best", "runs/dive/2026-11-03_09-30-00/best"),
        ("09-30", "runs/dive/2026-11-03_09-30-00"),
        ("seed=1", f"{SWEEP}/num_envs=8,seed=1,task=dive"),  # not seed=10
        ("sweeps/2026-10-31_00-00-00/seed=10", f"{SWEEP}/num_envs=8,seed=10,task=dive"),  # as ogmp-runs shows it
        ("parkour", "parkour"),  # that ships, whatever begins the same way here
        ("dive", "dive"),
    ],
)
def test_a_run_is_named_by_path_by_age_and_by_a_part_of_its_name(text: str, meant: str, here: Path) -> None:
    assert find_run(text) == meant


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("2026-11", r"'2026-11' may be 'dive/2026-11-03_09-30-00', 'parkour/2026-11-02_12-00-00', 'parkour/2026-11-01"),
        ("park", r"'park' may be the policy 'parkour' that ships, 'parkour/2026-11-02_12-00-00', .*: give more of the"),
        ("dive/2026-11-04", r"neither a run directory nor a shipped policy .*the closest: 'dive/2026-11-03_09-30-00'"),
        (
            "frist",
            r"'frist' is neither a run directory nor a shipped policy \(allowed: .*\. Of .* the closest: 'first'",
        ),
        ("latset", r"the closest: 'latest'"),
        ("xyzzy", r"Of the runs below 'runs', the newest: 'first', 'dive/2026-11-03_09-30-00'"),
        (SWEEP, rf"'{SWEEP}' has 3 jobs: give one of them, e.g. '{SWEEP}/num_envs=8,seed=10,task=dive', or compare"),
        ("seed=", r"'seed=' may be 'sweeps/2026-10-31_00-00-00/seed=10', "),
        ("", "'' is a directory here, but neither a run nor a policy"),
        ("a\0b", "neither a run directory nor a shipped policy"),
        ("x" * 5000, "neither a run directory nor a shipped policy"),
        ("*", "neither a run directory nor a shipped policy"),
        ("../runs/first", "neither a run directory nor a shipped policy"),
    ],
)
def test_what_names_no_run_or_several_is_a_sentence_with_the_closest(text: str, sentence: str, here: Path) -> None:
    with pytest.raises((KeyError, ValueError), match=sentence) as caught:
        find_run(text)
    assert "\n" not in str(caught.value.args[0]).replace(text, "")


def test_the_latest_run_without_a_checkpoint_is_not_passed_over_in_silence(here: Path) -> None:
    add(here / "runs" / "new", 9999, checkpoint=0)
    with pytest.raises(KeyError, match=r"'runs/new', has no checkpoint yet; the newest that has one is 'runs/first'"):
        find_run("latest")
    assert find_run("latest", to_resume=True) == "runs/new"


def test_the_latest_run_of_a_sweep_with_several_jobs_is_not_guessed(here: Path) -> None:
    job = here / SWEEP / "num_envs=8,seed=2,task=dive" / "config.yaml"
    os.utime(job, (9999, 9999))
    with pytest.raises(
        ValueError, match=r"is a job of a sweep, and 'runs/sweeps/.*' has 3 jobs: .*seed=2,task=dive', or"
    ):
        find_run("latest")


def test_without_runs_latest_says_so(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeyError, match=r"'latest': no run is below 'runs' here yet"):
        find_run("latest")


def test_a_shipped_name_and_a_folder_of_runs_are_told_apart(here: Path, monkeypatch) -> None:
    monkeypatch.chdir(here / "runs")
    with pytest.raises(
        ValueError, match=r"'parkour' .*write ./parkour for the newest run in it, or /.*/policies/parkour"
    ):
        find_run("parkour")
    assert find_run("./parkour") == "parkour/2026-11-02_12-00-00"


def test_only_a_run_can_be_resumed(here: Path) -> None:
    with pytest.raises(ValueError, match="'parkour' is a policy that ships: there is no training to go on with"):
        find_run("parkour", to_resume=True)
