"""ogmp-play as a user runs it."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from helpers.programs import SMALL, program
from ogmp_sb3.commands.play import PlayConfig, _cast, _policies, load
from ogmp_sb3.rendering.player import Player


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A policy that has hardly trained."""
    folder = tmp_path_factory.mktemp("play")
    done = program("train", "task=parkour", "total_timesteps=128", *SMALL, "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


def test_overrides_and_scene_change_the_task_that_a_policy_plays(run: Path) -> None:
    task, policy = load(PlayConfig(run=str(run), scene="pace_to_jump"), ["oracle=lqr", "rho=0.3"])
    assert (task.oracle, task.rho) == ("lqr", 0.3)
    player = Player(task, policy)
    assert player.frame.mode == "pace v 0.60, length 1.50"
    assert player.step().time == pytest.approx(0.03)


def test_several_policies_play_the_same_track_and_several_robots_tracks_of_their_own() -> None:
    runs = PlayConfig(run="parkour,parkour", seed=3)
    first, second = _cast(runs, list(runs.runs), [], "")
    assert (first.name, first.later, second.later) == ("parkour", 0, 0)
    assert first.player.env.modes[0] == second.player.env.modes[0]
    one, other = _cast(PlayConfig(task="parkour", robots=2, seed=3), [], [], "")
    assert (one.name, other.name, other.later) == ("robot 1", "robot 2", 1)
    assert other.player.env.modes[0] == Player(other.player.task, None, 4).env.modes[0] != one.player.env.modes[0]


def test_the_policies_of_a_run_can_be_chosen_the_newest_checkpoint_second(run: Path, tmp_path: Path) -> None:
    names = _policies([str(run)])
    assert names[0] == "latest" and names[1] == "checkpoints/000000000128" and names[-1] == "best"
    assert _policies(["parkour"]) == _policies([str(run), str(run)]) == _policies([]) == []
    assert all(_cast(PlayConfig(run=str(run)), [str(run)], [], name) for name in names)


def test_a_directory_with_a_comma_in_its_name_is_one_run(tmp_path: Path) -> None:
    (tmp_path / "a,b").mkdir()
    assert PlayConfig(run=str(tmp_path / "a,b")).runs == (str(tmp_path / "a,b"),)
    assert PlayConfig(run="a, b").runs == ("a", "b")


def test_a_task_without_a_policy_takes_the_same_keys() -> None:
    task, policy = load(PlayConfig(task="parkour", scene="faster"), ["track.width=3.0"])
    assert policy is None
    assert (task.track.width, len(task.sampling.sequence)) == (3.0, 4)


def test_a_policy_plays_into_a_file(opengl, run: Path, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="drawing needs the extra 'viewer'")
    done = program("play", f"run={run}", "video=out/a.gif", "seconds=0.24", "seed=3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "out/a.gif"
    with image.open(tmp_path / "out" / "a.gif") as gif:
        assert gif.n_frames == 5


def test_a_policy_s_test_episodes_are_written_into_a_page(run: Path, tmp_path: Path) -> None:
    done = program(
        "play", f"run={run}", "web=out/page", "episodes=3", "seed=2", "evaluation.episode_steps=12", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "out/page/index.html"
    page = (tmp_path / done.stdout.strip()).read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page).group(1))
    assert {e["name"] for e in data["episodes"]} >= {"best", "median"}
    assert {e["detail"].partition(",")[0] for e in data["episodes"]} <= {"seed 2", "seed 3", "seed 4"}
    assert all(e["steps"] <= 13 for e in data["episodes"])
    assert "3 of 3 test episodes, chosen by return" in page


def test_an_oracle_s_way_is_written_into_a_page_where_one_was_before(tmp_path: Path) -> None:
    for seconds in ("0.3", "0.6"):
        done = program("play", "task=dive", "web=page", f"seconds={seconds}", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    (episode,) = json.loads(re.search(r'id="data">(.*?)</script>', page).group(1))["episodes"]
    assert (episode["steps"], episode["robot"]) == (21, None)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["seed=1"], "give either 'run' (a policy) or 'task'"),
        (["run=a", "task=parkour"], "give either 'run' (a policy) or 'task'"),
        (["task=parkuor"], "Did you mean 'parkour'?"),
        (["run=nowhere"], "neither a run directory nor a shipped policy"),
        (["task=parkour", "video=a.avi"], "'video' must end in .mp4, .gif, .png"),
        (["task=parkour", "scene=pace_to_jmp"], "Did you mean 'pace_to_jump'?"),
        (["task=parkour", "sedd=1"], "Did you mean 'seed'?"),
        (["task=parkour", "seconds=0"], "'seconds' must be above 0"),
        (["task=parkour", "modes.jump.hh=1"], "no parameter 'hh'"),
        (["run=parkour", "web=a", "video=a.gif"], "give either 'video' (a file) or 'web' (a directory for a page)"),
        (["run=parkour", "web=a", "episodes=0"], "'episodes' must be at least 1"),
        (["run=parkour", "episodes=4"], "'episodes' is for a page of a policy"),
        (["task=parkour", "web=a", "episodes=4"], "'episodes' is for a page of a policy"),
        (["run=parkour", "web=a", "seconds=4"], "evaluation.episode_steps="),
        (["run=parkour", "web=a", "track.length=4"], "a test has evaluation.track_length"),
        (["run=parkour", "web=."], "holds 'mine.txt', which is no replay"),
        (["run=parkour", "web=mine.txt"], "'mine.txt' is a file"),
        (["run=parkour", "web=mine.txt/page"], "nothing can be saved there"),
        (["task=parkour", "robots=0"], "'robots' must be from 1 to 16, found 0"),
        (["task=parkour", "robots=2", "video=a.mp4"], "several robots are for the browser"),
        (["run=parkour,dive", "robots=2"], "give either 'robots' of one policy, or several policies"),
        (["run=parkour,nowhere", "port=0"], "'nowhere' is neither a run directory nor a shipped policy"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], sentence: str, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("")
    done = program("play", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_the_viewer_says_where_it_listens_and_stops_on_ctrl_c() -> None:
    pytest.importorskip("viser", reason="the browser viewer needs the extra 'viewer'")
    command = [sys.executable, "-u", "-m", "ogmp_sb3.commands.play", "task=dive", "port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as viewer:
        assert viewer.stdout is not None and viewer.stderr is not None
        line = next(line for line in viewer.stdout if "http://" in line)
        url = next(word for word in line.split() if word.startswith("http://"))
        assert url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(url) as page:
            assert page.status == 200
        viewer.send_signal(signal.SIGINT)
        try:
            # To a shell both are 130; Python chooses the second if a module was just being imported.
            assert viewer.wait(30) in (130, -signal.SIGINT)
        finally:
            viewer.kill()  # leaving the block waits for it
        assert "Traceback" not in viewer.stderr.read()
