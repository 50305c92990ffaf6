"""Policies and trainings on disk: safetensors and JSON only, nothing that can run code.

A policy is a directory with ``policy.safetensors`` (weights and normaliser), ``policy.json`` (its task and network)
and, if it observes the mode latent, ``encoder/``. A checkpoint of a training is such a directory with
``trainer.safetensors`` and ``trainer.json`` beside, which hold everything else that the next step depends on, and
``manifest.json`` with the checksums.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import warnings
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from ogmp_sb3.adapters import OgmpVecEnv
from ogmp_sb3.config import PACKAGE, task_from_data
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.latent import copy_encoder
from ogmp_sb3.observations import CLIP
from ogmp_sb3.policy import LstmPolicy, Normaliser
from ogmp_sb3.recurrent import RecurrentPPO
from ogmp_sb3.registry import did_you_mean

FORMAT = 1
MANIFEST = "manifest.json"
ENCODER = "encoder"  # directory beside the weights: the encoder a policy was trained with
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


def save_checkpoint(
    model: RecurrentPPO,
    folder: Path,
    info: dict[str, Any],
    statistics: dict[str, Any] | None = None,
    average: dict[str, th.Tensor] | None = None,
) -> None:
    """Write a policy and all its training needs to go on bit for bit; all or nothing.

    To be called between two updates: rollout buffers are not saved.

    :param model: the learner, on an :class:`~ogmp_sb3.adapters.OgmpVecEnv`
    :param folder: the directory to make; an existing one is replaced
    :param info: plain data for ``policy.json``: the task and how the policy came about
    :param statistics: plain data of the logs, given back by :func:`load_trainer`
    :param average: weights of the policy that is kept, if they are not those that the training goes on from
    """
    env = model.env
    assert isinstance(env, OgmpVecEnv)
    arrays, plain = env.state()
    trainer = {
        "num_timesteps": model.num_timesteps,
        "updates": model._n_updates,
        "episodes": list(model.ep_info_buffer or []),
        "statistics": statistics or {},
        "environment": plain,
        "python_generator": random.getstate(),
        "numpy_generator": _numpy_generator(),
    }
    tensors = {f"env.{name}": th.as_tensor(array) for name, array in arrays.items()}
    tensors |= {f"lstm.{i}": tensor for i, tensor in enumerate(_lstm_tensors(model))}
    tensors |= {f"optimiser.{name}": tensor for name, tensor in _optimiser_tensors(model).items()}
    if average is not None:
        tensors |= {f"policy.{name}": tensor for name, tensor in model.policy.state_dict().items()}
    tensors["torch_generator"] = th.get_rng_state()
    tensors["last_observation"] = th.as_tensor(model._last_obs)
    tensors["last_episode_starts"] = th.as_tensor(model._last_episode_starts)

    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    _save_tensors(temporary / "policy.safetensors", average or model.policy.state_dict())
    _save_json(temporary / "policy.json", {"format": FORMAT, "network": _network(model.policy), **info})
    _save_tensors(temporary / "trainer.safetensors", tensors)
    _save_json(temporary / "trainer.json", trainer)
    if env.batch.task.uses_latent and env.batch.task.encoder:
        copy_encoder(env.batch.task.encoder, temporary / ENCODER)
    files = sorted(file for file in temporary.rglob("*") if file.is_file())
    sums = {file.relative_to(temporary).as_posix(): _checksum(file) for file in files}
    _save_json(temporary / MANIFEST, sums)
    if folder.exists():
        shutil.rmtree(folder)
    temporary.rename(folder)
    _sync(folder.parent)


def load_trainer(model: RecurrentPPO, folder: Path) -> dict[str, Any]:
    """Put a checkpoint's weights, optimiser, generators and simulations into a fresh learner.

    :param model: a learner with the same network, task and number of environments
    :param folder: the checkpoint
    :return: the statistics given to :func:`save_checkpoint`
    :raises ValueError: if the checkpoint is damaged or does not fit
    """
    verify(folder)
    tensors = _load_tensors(folder / "trainer.safetensors")
    last = {k.removeprefix("policy."): t for k, t in tensors.items() if k.startswith("policy.")}
    _set_weights(model.policy, last or policy_weights(folder), folder)
    trainer = _load_json(folder / "trainer.json")
    env = model.env
    assert isinstance(env, OgmpVecEnv)
    try:
        state = model.policy.optimizer.state_dict()
        state["state"] = {
            i: {name: tensors[f"optimiser.{i}.{name}"] for name in ("step", "exp_avg", "exp_avg_sq")}
            for i in state["param_groups"][0]["params"]
            if f"optimiser.{i}.step" in tensors
        }
        model.policy.optimizer.load_state_dict(state)
        arrays = {k.removeprefix("env."): t.numpy() for k, t in tensors.items() if k.startswith("env.")}
        env.set_state(arrays, trainer["environment"])
        model.num_timesteps, model._n_updates = trainer["num_timesteps"], trainer["updates"]
        model.ep_info_buffer = deque(trainer["episodes"], maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(maxlen=model._stats_window_size)
        model._last_obs = tensors["last_observation"].numpy()
        model._last_episode_starts = tensors["last_episode_starts"].numpy()
        lstm = [tensors[f"lstm.{i}"] for i in range(4)]
        model._last_lstm_states = RNNStates((lstm[0], lstm[1]), (lstm[2], lstm[3]))
        version, internal, gauss = trainer["python_generator"]
        random.setstate((version, tuple(internal), gauss))
        np.random.set_state(trainer["numpy_generator"])
        th.set_rng_state(tensors["torch_generator"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{folder}: the checkpoint does not fit ({error}).") from None
    return trainer["statistics"]  # type: ignore[no-any-return]


def copy_policy(checkpoint: Path, folder: Path) -> None:
    """Copy what a policy needs out of a checkpoint, all or nothing; an existing copy is replaced."""
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    for name in ("policy.safetensors", "policy.json"):
        shutil.copy(checkpoint / name, temporary / name)
        _sync(temporary / name)
    if (checkpoint / ENCODER).is_dir():
        copy_encoder(str(checkpoint / ENCODER), temporary / ENCODER)
    if folder.exists():
        shutil.rmtree(folder)
    temporary.rename(folder)


def verify(folder: Path) -> None:
    """Check that every file of a checkpoint is there and as it was written.

    :raises ValueError: naming the first that is not
    """
    for name, expected in _load_json(folder / MANIFEST).items():
        file = folder / name
        if ".." in Path(name).parts or not file.is_file() or _checksum(file) != expected:
            raise ValueError(f"{file}: damaged or missing (its checksum is not that of {MANIFEST}).")


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
        if (folder / ENCODER).is_dir():
            info["task"]["encoder"] = str(folder / ENCODER)
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
    _set_weights(policy, policy_weights(folder), folder)
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
        "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # SB3's epsilon; fused is the same in fewer calls
        "features_extractor_class": Normaliser,
        "features_extractor_kwargs": {"scale": [float(s) for s in scale]},
    }


def policy_weights(folder: Path) -> dict[str, th.Tensor]:
    """The weights of a policy, from its directory.

    :raises ValueError: if they are not readable
    """
    return _load_tensors(folder / "policy.safetensors")


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


def checkpoint_info(folder: Path) -> dict[str, Any]:
    """What the ``policy.json`` of a checkpoint says: the task, the samples, the mean return, the versions."""
    return _load_json(folder / "policy.json")


def latest_checkpoint(run_dir: Path) -> Path:
    """The newest checkpoint that is whole; damaged ones are passed over with a warning.

    :raises KeyError: if the run has none
    """
    for folder in reversed(checkpoint_dirs(run_dir)):
        try:
            verify(folder)
        except ValueError as error:
            warnings.warn(f"{error} Falling back to the checkpoint before.", stacklevel=2)
        else:
            return folder
    raise KeyError(f"'{run_dir}' has no checkpoint to load.")


def _network(policy: Any) -> dict[str, Any]:
    return {
        "scale": policy.features_extractor.floor.tolist(),
        "actions": int(policy.action_space.shape[0]),
        "kwargs": {
            "lstm_hidden_size": policy.lstm_actor.hidden_size,
            "n_lstm_layers": policy.lstm_actor.num_layers,
        },
    }


def _numpy_generator() -> list[Any]:
    name, keys, *rest = np.random.get_state()
    return [name, np.asarray(keys).tolist(), *rest]


def _lstm_tensors(model: RecurrentPPO) -> list[th.Tensor]:
    states = model._last_lstm_states
    assert states is not None
    return [*states.pi, *states.vf]


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _optimiser_tensors(model: RecurrentPPO) -> dict[str, th.Tensor]:
    state = model.policy.optimizer.state_dict()["state"]
    return {f"{i}.{name}": th.as_tensor(value) for i, entry in state.items() for name, value in entry.items()}


def _set_weights(policy: Any, weights: dict[str, th.Tensor], folder: Path) -> None:
    try:
        policy.load_state_dict(weights)
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
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
