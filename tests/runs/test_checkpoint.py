"""Policies and checkpoints on disk: damaged or tampered with, they are refused in one sentence and run nothing."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file, save_file

from helpers.learners import learner, policy_info, update
from helpers.programs import SMALL, program
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.runs.checkpoint import copy_policy, latest_checkpoint, load_trainer, save_checkpoint, try_checkpoint
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.runs.storage import MANIFEST, verify, write_manifest


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run with one checkpoint, and everything else that a training leaves."""
    folder = tmp_path_factory.mktemp("run")
    arguments = ["task=parkour", *SMALL, "ppo.lstm_hidden_size=8", "total_timesteps=128", "keep_checkpoints=1"]
    done = program("train", *arguments, "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    """A checkpoint without a run."""
    model, callback = learner()
    update(model, callback)
    folder = tmp_path_factory.mktemp("saved") / "000000000016"
    save_checkpoint(model, folder, policy_info())
    return folder


CHECKPOINT = [
    "policy.json", "policy.safetensors", "trainer.json", "trainer.safetensors", "manifest.json",
    "encoder/encoder.json", "encoder/encoder.safetensors",
]  # fmt: skip
RUN = ["config.yaml", "progress.csv", "encoder/encoder.json", "encoder/encoder.safetensors"]


class Bomb:
    """Leaves a file when it is unpickled, or read by a YAML reader that makes objects."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def damages(mark: Path) -> dict[str, Callable[[bytes], bytes]]:
    yaml = f"!!python/object/apply:os.system ['touch {mark}']\n"
    return {
        "empty": lambda content: b"",
        "half": lambda content: content[: len(content) // 2],
        "noise": lambda content: np.random.default_rng(0).bytes(len(content)),
        "pickle": lambda content: pickle.dumps(Bomb(mark)),
        "code": lambda content: yaml.encode(),
    }


def one_sentence(text: str) -> bool:
    lines = [line for line in text.splitlines() if line.strip()]
    return len(lines) == 1 and "Traceback" not in text and lines[0].startswith("ogmp-")


@pytest.mark.parametrize("damage", damages(Path()))
@pytest.mark.parametrize("name", CHECKPOINT)
def test_a_damaged_file_of_a_checkpoint_is_named_for_resume_and_eval(
    name: str, damage: str, run: Path, tmp_path: Path
) -> None:
    copy, mark = shutil.copytree(run, tmp_path / "run"), tmp_path / "it ran"
    file = checkpoint_dirs(copy)[-1] / name
    file.write_bytes(damages(mark)[damage](file.read_bytes()))
    before = _contents(copy)

    alone = program("eval", f"run={checkpoint_dirs(copy)[-1]}", "episodes=1", "out=eval", cwd=tmp_path)
    assert alone.returncode == 2 and file.name in alone.stderr and one_sentence(alone.stderr)
    for name_, arguments in (
        ("eval", [f"run={copy}", "episodes=1", "out=eval"]),
        ("train", [f"resume={copy}", "total_timesteps=256"]),
    ):
        with pytest.warns(UserWarning, match=f"{file.name}: .*Falling back"):
            done = program(name_, *arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert "has no checkpoint to load" in done.stderr and one_sentence(done.stderr)
    assert _contents(copy) == before
    assert not mark.exists() and not (tmp_path / "eval").exists()


def _contents(run: Path) -> dict[Path, bytes]:
    """All files of a run but its transcript, which has what was said."""
    return {path: path.read_bytes() for path in run.rglob("*") if path.is_file() and path.name != "train.log"}


@pytest.mark.parametrize("damage", damages(Path()))
@pytest.mark.parametrize("name", RUN)
def test_a_damaged_file_of_a_run_is_named_by_resume(name: str, damage: str, run: Path, tmp_path: Path) -> None:
    copy, mark = shutil.copytree(run, tmp_path / "run"), tmp_path / "it ran"
    file = copy / name
    content = damages(mark)[damage](file.read_bytes())
    file.write_bytes(content)
    checkpoint = {path: path.read_bytes() for path in checkpoint_dirs(copy)[-1].rglob("*") if path.is_file()}
    done = program("train", f"resume={copy}", "total_timesteps=128", cwd=tmp_path)
    assert done.returncode == 2, done.stdout
    assert file.name in done.stderr and one_sentence(done.stderr)
    assert file.read_bytes() == content
    assert {path: path.read_bytes() for path in checkpoint} == checkpoint
    assert not mark.exists()
    assert load_policy(copy).task.name == "parkour"  # an evaluation needs none of these files


# ---- tampered with, checksums and all ----


def tampered(saved: Path, tmp_path: Path) -> Path:
    return shutil.copytree(saved, tmp_path / saved.name)


def seal(folder: Path) -> None:
    (folder / MANIFEST).unlink()
    write_manifest(folder)


NETWORK = {"lstm_hidden_size": 8, "n_lstm_layers": 1}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": 2}, "format 2, expected 1"),
        ({"format": None}, "format None"),
        ({"task": None}, "'task' must be a mapping"),
        ({"task": {"modes": 3}}, "dive.yaml"),
        ({"robot": 3}, "'robot' must be a mapping"),
        ({"robot": {}}, "'robot.digest' is missing"),
        ({"task_file": 3}, "'task_file' must be text"),
        ({"network": None}, "'network' must be a mapping"),
        ({"network": {"actions": 10, "kwargs": NETWORK}}, "'network.scale' is missing"),
        ({"network": {"scale": [1.0], "actions": 10, "kwargs": NETWORK}}, "'network' does not fit policy.safetensors"),
        ({"actions": 10**9}, "'network' does not fit policy.safetensors"),
        ({"actions": -1}, "'network' does not fit policy.safetensors"),
        ({"kwargs": {**NETWORK, "lstm_hidden_size": 10**6}}, "'network' does not fit policy.safetensors"),
        ({"kwargs": {**NETWORK, "n_lstm_layers": 10**9}}, "'network' does not fit policy.safetensors"),
        ({"kwargs": {**NETWORK, "input_layers": [10**9]}}, "'network' does not fit policy.safetensors"),
        ({"kwargs": {**NETWORK, "critic_layers": [7]}}, "'network' does not fit policy.safetensors"),
        ({"kwargs": {**NETWORK, "features_extractor_class": "os.system"}}, "is not a known key"),
        ({"versions": [1]}, "'versions' must be a mapping"),
        ({"num_timesteps": "many"}, "'num_timesteps' must be a whole number"),
    ],
)
def test_a_policy_json_that_says_something_else_is_a_sentence(
    change: dict[str, Any], sentence: str, saved: Path, tmp_path: Path
) -> None:
    folder = tampered(saved, tmp_path)
    info = json.loads((folder / "policy.json").read_text())
    within = info["network"] if set(change) <= {"actions", "kwargs"} else info
    within.update(change)
    (folder / "policy.json").write_text(json.dumps(info))
    seal(folder)
    with pytest.raises(ValueError, match=sentence) as caught:
        load_policy(folder)
    assert "policy.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("reader", ["policy", "trainer"])
@pytest.mark.parametrize("change", ["missing", "shape", "nan", "another"])
def test_weights_that_are_others_are_a_sentence(change: str, reader: str, saved: Path, tmp_path: Path) -> None:
    folder = tampered(saved, tmp_path)
    file = folder / "policy.safetensors"
    tensors = load_file(file)
    name = "value_net.weight"
    if change == "missing":
        del tensors[name]
    elif change == "shape":
        tensors[name] = th.zeros(2, 8)
    elif change == "nan":
        tensors[name][0, 0] = float("nan")
    else:
        tensors = {"weights": th.zeros(3)}
    save_file(tensors, file)
    seal(folder)
    with pytest.raises(ValueError, match=r"policy\.safetensors") as caught:
        load_policy(folder) if reader == "policy" else load_trainer(learner()[0], folder)
    assert "\n" not in str(caught.value)


def test_a_trainer_json_that_says_something_else_is_a_sentence(saved: Path, tmp_path: Path) -> None:
    folder = tampered(saved, tmp_path)
    plain = json.loads((folder / "trainer.json").read_text())
    (folder / "trainer.json").write_text(json.dumps({**plain, "environment": {"modes": "__import__('os')"}}))
    seal(folder)
    with pytest.raises(ValueError, match=r"trainer\.safetensors or trainer\.json does not fit this run") as caught:
        load_trainer(learner()[0], folder)
    assert "\n" not in str(caught.value)


def test_a_manifest_that_leaves_a_file_out_is_a_sentence(saved: Path, tmp_path: Path) -> None:
    folder = tampered(saved, tmp_path)
    sums = json.loads((folder / MANIFEST).read_text())
    for name in ("policy.json", "trainer.safetensors"):
        (folder / MANIFEST).write_text(json.dumps({key: value for key, value in sums.items() if key != name}))
        with pytest.raises(ValueError, match=f"manifest.json: does not name '{name}'"):
            load_trainer(learner()[0], folder)


# ---- sound ones ----


def test_the_best_policy_is_verified_too(saved: Path, tmp_path: Path) -> None:
    copy_policy(saved, tmp_path / "best")
    verify(tmp_path / "best", "policy.safetensors", "policy.json")
    assert load_policy(tmp_path / "best").task.name == "dive"
    file = tmp_path / "best" / "policy.safetensors"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(ValueError, match=r"policy\.safetensors: damaged or missing"):
        load_policy(tmp_path / "best")


def test_a_policy_without_a_manifest_is_loaded_as_those_that_ship_are(saved: Path, tmp_path: Path) -> None:
    folder = tampered(saved, tmp_path)
    (folder / MANIFEST).unlink()
    assert load_policy(folder).task.name == "dive"


def test_trying_a_checkpoint_leaves_nothing(tmp_path: Path) -> None:
    model, _ = learner()
    try_checkpoint(model, tmp_path / "checkpoints" / "000000000000")
    assert [path.name for path in tmp_path.rglob("*")] == ["checkpoints"]


def test_only_directories_with_a_number_are_checkpoints(saved: Path, tmp_path: Path) -> None:
    for name in ("000000000016", "7 copy", "damaged-000000000032", ".000000000048.tmp"):
        shutil.copytree(saved, tmp_path / "checkpoints" / name)
    assert [folder.name for folder in checkpoint_dirs(tmp_path)] == ["000000000016"]
    assert latest_checkpoint(tmp_path).name == "000000000016"


def test_a_policy_outlives_the_checkpoint_it_was_loaded_from(run: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    loaded = load_policy(copy)
    assert loaded.path.parent == copy / "checkpoints"
    shutil.rmtree(loaded.path)  # as a training does that goes on
    BatchEnv(loaded.task, 1)


def test_an_encoder_that_is_not_the_runs_is_the_policys_own(run: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    (copy / "encoder" / "encoder.json").write_text("{}")
    assert load_policy(copy).task.encoder == str(checkpoint_dirs(copy)[-1] / "encoder")


def test_the_digest_is_of_what_counts_and_not_of_paths(run: Path, tmp_path: Path, monkeypatch) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    digest = load_policy("run").digest
    assert load_policy(copy).digest == load_policy(f"../{tmp_path.name}/run").digest == digest
    robot = load_policy(copy).task.robot_config
    mjcf, heavier = robot.mjcf_path.read_text(encoding="utf-8"), tmp_path / "heavier.xml"
    loaded = load_policy(copy)
    task = replace(loaded.task, robot_config=replace(robot, mjcf=str(heavier)))
    for change, same in ((("</mujoco>", "</mujoco><!-- -->"), True), (('mass="', 'mass="1'), False)):
        heavier.write_text(mjcf.replace(*change), encoding="utf-8")
        assert (replace(loaded, task=task).digest == digest) == same
    other = replace(loaded.task, encoder="dive")
    assert replace(loaded, task=other).digest != digest
