"""Films of a training, which does not notice them."""

from __future__ import annotations

import shutil
import subprocess
import warnings
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file

from helpers.learners import learner, update
from helpers.programs import SMALL, program
from ogmp_sb3.runs import films
from ogmp_sb3.runs.films import Films, film
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.sb3.policy_average import PolicyAverage

TINY = ["task=dive", "rho=0.2", *SMALL, "ppo.n_epochs=1"]
ROLLOUT = 128


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, int]]:
    """What would be filmed: the policy's weights, and how many frames. Nothing is drawn, but a file comes of it."""
    made: list[tuple[Any, int]] = []

    def write(frames: list[Any], task: Any, path: Path, kind: Any) -> None:
        made.append((frames, len(frames)))
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"a film")

    monkeypatch.setattr(films, "write_video", write)
    monkeypatch.setattr("ogmp_sb3.commands.train.jobs.gl_library", lambda: "none")
    return made


def trained(folder: Path, *arguments: str) -> dict[str, th.Tensor]:
    """The weights that a training of four rollouts ends with, and the state of all that it draws from."""
    done = program(
        "train", *TINY, f"total_timesteps={4 * ROLLOUT}", f"hydra.run.dir={folder}", *arguments, cwd=folder.parent
    )
    assert done.returncode == 0, done.stderr
    last = checkpoint_dirs(folder)[-1]
    return load_file(last / "policy.safetensors") | load_file(last / "trainer.safetensors")


def test_a_filmed_training_is_the_same_bit_for_bit(drawn: list[Any], tmp_path: Path) -> None:
    plain, filmed = trained(tmp_path / "plain"), trained(tmp_path / "filmed", "videos=200")
    assert [file.name for file in sorted((tmp_path / "filmed" / "videos").iterdir())] == [
        "000000000256.mp4", "000000000512.mp4",  # 128 and 384 pass no multiple of 200
    ]  # fmt: skip
    assert len(drawn) == 2
    assert plain.keys() == filmed.keys()
    assert all(th.equal(plain[name], filmed[name]) for name in plain)


def test_a_run_that_goes_on_is_filmed_where_it_was_not(drawn: list[Any], tmp_path: Path) -> None:
    trained(tmp_path / "run", "videos=128", "checkpoint_interval=128")
    names = [file.name for file in sorted((tmp_path / "run" / "videos").iterdir())]
    assert names == [f"{ROLLOUT * k:012d}.mp4" for k in (1, 2, 3, 4)]
    shutil.rmtree(checkpoint_dirs(tmp_path / "run")[-1])  # as if killed after the film, before the checkpoint
    (tmp_path / "run" / "videos" / names[-2]).write_bytes(b"of before")
    (tmp_path / "run" / "videos" / names[-1]).unlink()
    done = program("train", "resume=run", f"total_timesteps={5 * ROLLOUT}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(drawn) == 6 and (tmp_path / "run" / "videos" / names[-2]).read_bytes() == b"of before"
    assert (tmp_path / "run" / "videos" / f"{5 * ROLLOUT:012d}.mp4").is_file()


def test_what_is_filmed_is_the_policy_that_is_kept_and_generators_stay_as_they_were(
    drawn, tmp_path: Path, monkeypatch
) -> None:
    model, callback = learner()
    average = PolicyAverage(over=10**6)
    average.init_callback(model)
    average._on_training_start()
    for _ in range(2):
        update(model, callback)
        average._on_rollout_start()
    filmed: list[dict[str, th.Tensor]] = []
    monkeypatch.setattr(films, "film", lambda policy, task, file: filmed.append(policy.state_dict()))
    for weights, each in ((average.weights, average), (model.policy.state_dict(), None)):
        camera = Films(tmp_path, model.env.batch.task, 1, each)
        camera.init_callback(model)
        before = th.get_rng_state(), np.random.get_state()[1].tolist()
        camera._on_rollout_start()
        assert th.equal(th.get_rng_state(), before[0]) and np.random.get_state()[1].tolist() == before[1]
        assert all(th.equal(weights[name], filmed[-1][name]) for name in weights)
    assert not all(th.equal(filmed[0][name], filmed[1][name]) for name in filmed[0])


@pytest.mark.parametrize("error", [ValueError("drawing failed."), OSError(28, "No space left on device"), KeyError()])
def test_a_film_that_fails_is_told_once_and_leaves_nothing(error: Exception, tmp_path: Path, monkeypatch) -> None:
    model, callback = learner()

    def fail(frames: list[Any], task: Any, path: Path, kind: Any) -> None:
        path.write_bytes(b"half a film")
        raise error

    monkeypatch.setattr(films, "write_video", fail)
    camera = Films(tmp_path, model.env.batch.task, 1)
    camera.init_callback(model)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(2):
            update(model, callback)
            camera._on_rollout_start()
    told = [str(warning.message) for warning in said if "not filmed" in str(warning.message)]
    assert len(told) == 1 and told[0].endswith("; the training goes on.")
    assert told[0].startswith(f"{tmp_path / '000000000016.mp4'}: not filmed (")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("missing", "sentence"),
    [("package", "the package 'PIL' is missing: pip install \"ogmp_sb3[viewer]\"."), ("OpenGL", "'videos': no OpenGL")],
)
def test_what_is_missing_is_told_before_anything_is_made(
    missing: str, sentence: str, tmp_path: Path, monkeypatch
) -> None:
    if missing == "package":
        monkeypatch.setattr("ogmp_sb3.commands.cli.importlib.util.find_spec", lambda name: None)
    else:
        monkeypatch.setenv("MUJOCO_GL", "nonsense")
    done = program("train", "task=dive", "videos=1000", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "") and sentence in done.stderr
    assert list(tmp_path.iterdir()) == []
    assert "'videos' must be at least 1" in program("train", "task=dive", "videos=0", cwd=tmp_path).stderr


def test_a_film_is_a_video_of_five_seconds(opengl: None, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(films, "SECONDS", 0.3)  # 11 frames, of which every second one is drawn
    model, _ = learner()
    film(model.policy, model.env.batch.task, tmp_path / "videos" / "a.mp4")
    assert [file.name for file in (tmp_path / "videos").iterdir()] == ["a.mp4"]
    probe = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(tmp_path / "videos" / "a.mp4")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "480x272" in probe.stderr and "16.67 fps" in probe.stderr and "Duration: 00:00:00.36" in probe.stderr
