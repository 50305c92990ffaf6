"""Files that can hold pickles: refused unread, and imported only when they are trusted."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from helpers.learners import learner, update
from helpers.programs import program
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.sb3_zip import PICKLES, load_zip


class Bomb:
    """Leaves a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.fixture(scope="module")
def model_zip(tmp_path_factory) -> tuple[Path, object]:
    model, callback = learner()
    update(model, callback)
    file = tmp_path_factory.mktemp("zip") / "mine.zip"
    model.save(file)
    return file, model


RUNS = {
    "eval": ["run={file}", "episodes=1"],
    "play": ["run={file}", "video=a.mp4"],
    "report": ["run={file}", "grids=false"],
    "export": ["run={file}", "out=exported"],
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("suffix", [".zip", ".pt", ".pkl"])
def test_every_program_refuses_a_pickle_without_reading_it(name: str, suffix: str, tmp_path: Path) -> None:
    file, mark = tmp_path / f"model{suffix}", tmp_path / "it ran"
    bomb = pickle.dumps(Bomb(mark))
    if suffix == ".zip":
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("policy.pth", bomb)
    else:
        file.write_bytes(bomb)
    done = program(name, *(argument.format(file=file) for argument in RUNS[name]), cwd=tmp_path)
    assert done.returncode == 2
    assert "run any code they like" in done.stderr and "trust=true" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not mark.exists()


@pytest.mark.parametrize("suffix", sorted({*PICKLES} - {".zip"}))
def test_trust_is_for_a_zip_alone(suffix: str, tmp_path: Path) -> None:
    file, mark = tmp_path / f"model{suffix}", tmp_path / "it ran"
    file.write_bytes(pickle.dumps(Bomb(mark)))
    with pytest.raises(ValueError, match=r"only the \.zip that RecurrentPPO\.save writes"):
        load_policy(file, trust=True, task="dive")
    assert not mark.exists()


def test_another_file_is_no_policy(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("")
    with pytest.raises(ValueError, match="is no policy: expected a run directory"):
        load_policy(file, trust=True, task="dive")


def test_a_zip_does_not_know_its_task_and_a_policy_does(model_zip) -> None:
    with pytest.raises(ValueError, match="does not say what it was trained on: give task="):
        load_policy(model_zip[0], trust=True)
    with pytest.raises(ValueError, match=r"'task' goes with an SB3 \.zip only"):
        load_policy("parkour", task="dive")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"nothing"])
def test_a_zip_that_is_none_is_a_sentence(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    file.write_bytes(content)
    with pytest.raises(ValueError, match="not readable as a RecurrentPPO") as caught:
        load_zip(file, True, "dive")
    assert "\n" not in str(caught.value)


def test_a_trusted_zip_acts_as_the_model_that_was_saved(model_zip) -> None:
    file, model = model_zip
    loaded = load_policy(file, trust=True, task="dive")
    assert (loaded.task.name, loaded.name, loaded.info["num_timesteps"]) == ("dive", "mine", model.num_timesteps)
    observation = np.random.default_rng(0).normal(size=(1, loaded.policy.observation_space.shape[0]))
    ours, _ = loaded.policy.predict(observation.astype(np.float32), deterministic=True)
    theirs, _ = model.predict(observation.astype(np.float32), deterministic=True)
    np.testing.assert_array_equal(ours, theirs)


def test_a_trusted_zip_is_evaluated(model_zip, tmp_path: Path) -> None:
    file, _ = model_zip
    arguments = [f"run={file}", "trust=true", "task=dive", "episodes=2", "evaluation.episode_steps=10"]
    done = program("eval", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "evaluation" / "mine" / "metrics.json").is_file()
