"""Policies and trainings on disk: safetensors and JSON only, nothing that can run code.

A policy is a directory with ``policy.safetensors`` (weights and normaliser) and ``policy.json`` (its task and
network). A checkpoint of a training is such a directory with ``trainer.safetensors`` and ``trainer.json`` beside.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from ogmp_sb3.config import PACKAGE, TaskConfig, task_from_data
from ogmp_sb3.observations import CLIP
from ogmp_sb3.recurrent import LstmPolicy, Normaliser, RecurrentPPO
from ogmp_sb3.registry import did_you_mean

FORMAT = 1
POLICIES_DIR = PACKAGE / "policies"


@dataclass(frozen=True)
class LoadedPolicy:
    """A policy from disk with the task it was trained on."""

    policy: LstmPolicy
    """ready for ``predict``"""
    task: TaskConfig
    """as it was in training"""
    task_data: dict[str, Any]
    """the task as plain data, for overrides"""
    task_path: Path
    """where the task came from"""
    info: dict[str, Any]
    """what ``policy.json`` says"""
    path: Path
    """the directory"""


def save_checkpoint(model: RecurrentPPO, folder: Path, info: dict[str, Any], trainer: dict[str, Any]) -> None:
    """Write a policy and what its training needs to go on, all or nothing.

    :param model: the learner
    :param folder: the directory to make; an existing one is replaced
    :param info: plain data for ``policy.json``: the task and how the policy came about
    :param trainer: plain data for ``trainer.json``
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    _save_tensors(temporary / "policy.safetensors", model.policy.state_dict())
    _save_json(temporary / "policy.json", {"format": FORMAT, "network": _network(model.policy), **info})
    _save_tensors(temporary / "trainer.safetensors", _optimiser_tensors(model))
    _save_json(temporary / "trainer.json", trainer)
    if folder.exists():
        shutil.rmtree(folder)
    temporary.rename(folder)


def load_trainer(model: RecurrentPPO, folder: Path) -> dict[str, Any]:
    """Put a checkpoint's weights and optimiser into a fresh learner; returns what ``trainer.json`` says.

    :raises ValueError: if the checkpoint is damaged or does not fit
    """
    _load_weights(model.policy, folder)
    tensors = _load_tensors(folder / "trainer.safetensors")
    state = model.policy.optimizer.state_dict()
    parameters = state["param_groups"][0]["params"]
    try:
        state["state"] = {
            i: {name: tensors[f"{i}.{name}"] for name in ("step", "exp_avg", "exp_avg_sq")}
            for i in parameters
            if f"{i}.step" in tensors
        }
    except KeyError as error:
        raise ValueError(f"{folder / 'trainer.safetensors'}: lacks {error}.") from None
    model.policy.optimizer.load_state_dict(state)
    return _load_json(folder / "trainer.json")


def load_policy(run: str | Path) -> LoadedPolicy:
    """Load a policy by the name of a shipped one, a policy or checkpoint directory, or a run directory.

    :raises ValueError: if the files are damaged
    :raises KeyError: if there is no such policy
    """
    folder = policy_dir(run)
    info = _load_json(folder / "policy.json")
    if info.get("format") != FORMAT:
        raise ValueError(f"{folder / 'policy.json'}: format {info.get('format')!r}, expected {FORMAT}.")
    try:
        task_path = Path(info["task_file"])
        task = task_from_data(info["task"], task_path)
        size, scale = info["network"]["actions"], np.array(info["network"]["scale"], dtype=np.float32)
        kwargs = info["network"]["kwargs"]
        policy = LstmPolicy(
            spaces.Box(-CLIP * scale, CLIP * scale, dtype=np.float32),
            spaces.Box(-1.0, 1.0, (size,), np.float32),
            lambda _: 0.0,
            **policy_kwargs(scale, **kwargs),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"{folder / 'policy.json'}: {error.args[0]}") from None
    _load_weights(policy, folder)
    policy.set_training_mode(False)
    return LoadedPolicy(policy, task, info["task"], task_path, info, folder)


def policy_kwargs(
    scale: np.ndarray, lstm_hidden_size: int, n_lstm_layers: int, log_std_init: float = 0.0
) -> dict[str, Any]:
    """The network of the paper: LSTM actor and critic without further layers, with a normaliser in front.

    :param scale: typical sizes of the observation's components
    """
    return {
        "net_arch": [],
        "lstm_hidden_size": lstm_hidden_size,
        "n_lstm_layers": n_lstm_layers,
        "enable_critic_lstm": True,
        "log_std_init": log_std_init,
        "features_extractor_class": Normaliser,
        "features_extractor_kwargs": {"scale": [float(s) for s in scale]},
    }


def policy_dir(run: str | Path) -> Path:
    """The directory that holds ``policy.json``.

    :raises KeyError: if there is none
    """
    path = Path(run)
    if (path / "policy.json").is_file():
        return path
    if (path / "checkpoints").is_dir():
        return latest_checkpoint(path)
    shipped = POLICIES_DIR / str(run)
    if (shipped / "policy.json").is_file():
        return shipped
    names = [p.parent.name for p in POLICIES_DIR.glob("*/policy.json")]
    raise KeyError(f"'{run}' is neither a run directory nor a shipped policy{did_you_mean(str(run), names)}")


def checkpoint_dirs(run_dir: Path) -> list[Path]:
    """All checkpoints of a run, oldest first."""
    return sorted(p for p in (run_dir / "checkpoints").glob("[0-9]*") if (p / "policy.json").is_file())


def latest_checkpoint(run_dir: Path) -> Path:
    """:raises KeyError: if the run has no checkpoint."""
    found = checkpoint_dirs(run_dir)
    if not found:
        raise KeyError(f"'{run_dir}' has no checkpoint to load.")
    return found[-1]


def _network(policy: LstmPolicy) -> dict[str, Any]:
    return {
        "scale": policy.features_extractor.floor.tolist(),
        "actions": int(policy.action_space.shape[0]),
        "kwargs": {
            "lstm_hidden_size": policy.lstm_actor.hidden_size,
            "n_lstm_layers": policy.lstm_actor.num_layers,
        },
    }


def _optimiser_tensors(model: RecurrentPPO) -> dict[str, th.Tensor]:
    state = model.policy.optimizer.state_dict()["state"]
    return {f"{i}.{name}": th.as_tensor(value) for i, entry in state.items() for name, value in entry.items()}


def _load_weights(policy: Any, folder: Path) -> None:
    try:
        policy.load_state_dict(_load_tensors(folder / "policy.safetensors"))
    except RuntimeError as error:
        raise ValueError(f"{folder / 'policy.safetensors'}: {str(error).splitlines()[0]}") from None


def _save_tensors(path: Path, tensors: dict[str, th.Tensor]) -> None:
    # Parts that are shared (the features extractor stands in the policy under several names) are written out.
    save_file({name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}, path)
    _sync(path)


def _load_tensors(path: Path) -> dict[str, th.Tensor]:
    try:
        return load_file(path)
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: not readable ({error}).") from None


def _save_json(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=1), encoding="utf-8")
    _sync(path)


def _load_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: not readable ({error}).") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: expected a mapping.")
    return data


def _sync(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())
