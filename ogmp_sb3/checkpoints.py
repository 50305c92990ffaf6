"""Policies and trainings on disk: safetensors and JSON only, nothing that can run code.

A policy is a directory with ``policy.safetensors`` (weights and normaliser), ``policy.json`` (its task and network)
and, if it observes the mode latent, ``encoder/``. A checkpoint of a training is such a directory with
``trainer.safetensors`` and ``trainer.json`` beside, which hold everything else that the next step depends on, and
``manifest.json`` with the checksums.
"""

from __future__ import annotations

import filecmp
import hashlib
import json
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces

from ogmp_sb3.adapters import OgmpVecEnv
from ogmp_sb3.config import PACKAGE, task_from_data, task_path
from ogmp_sb3.definitions import TaskConfig
from ogmp_sb3.files import fresh, put_in_place, remove
from ogmp_sb3.latent import copy_encoder, encoder_dir
from ogmp_sb3.observations import CLIP
from ogmp_sb3.policy import LstmPolicy, Network, policy_kwargs
from ogmp_sb3.recurrent import RecurrentPPO
from ogmp_sb3.registry import did_you_mean
from ogmp_sb3.sb3_zip import load_zip
from ogmp_sb3.schema import Where, read, read_yaml
from ogmp_sb3.storage import (
    MANIFEST,
    load_json,
    load_tensors,
    save_json,
    save_tensors,
    verify,
    write_manifest,
)
from ogmp_sb3.trainer import set_state, state

FORMAT = 1
CHECKPOINTS = "checkpoints"  # in a run directory: a directory for each, named by its samples
WEIGHTS, INFO = "policy.safetensors", "policy.json"
TRAINER = ("trainer.safetensors", "trainer.json")
ENCODER = "encoder"  # directory beside the weights: the encoder a policy was trained with
KNOWN = {"num_timesteps": int | None, "return": float | None, "versions": dict[str, str] | None}  # in policy.json
POLICIES_DIR = PACKAGE / "policies"
LAST = "policy."  # begins the names of the weights a training goes on from, where the policy kept is an average

Weights = dict[str, th.Tensor]


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
    """the directory, or the ``.zip``"""

    @property
    def name(self) -> str:
        """Name of the directory, or of the ``.zip`` without its ending."""
        return self.path.stem if self.path.is_file() else self.path.name

    @property
    def files(self) -> tuple[Path, ...]:
        """What the policy is made of; the weights first."""
        return (self.path,) if self.path.is_file() else (self.path / WEIGHTS, self.path / INFO)

    @property
    def digest(self) -> str:
        """Which policy it is, and of which task: the beginning of the SHA-256 of its files, its encoder's and its
        robot's, and of the task's data. The paths that they were found by do not matter.
        """
        robot, latent = self.task.robot_config, self.task.uses_latent and self.task.encoder
        encoder = sorted(encoder_dir(latent).iterdir()) if latent else []
        files = [*self.files, robot.path, robot.mjcf_path, *encoder]
        task = json.dumps({**self.task_data, "encoder": None}, sort_keys=True).encode()
        return hashlib.sha256(b"".join([*(file.read_bytes() for file in files), task])).hexdigest()[:16]


def save_checkpoint(
    model: RecurrentPPO,
    folder: Path,
    info: dict[str, Any],
    statistics: dict[str, Any] | None = None,
    average: Weights | None = None,
) -> None:
    """Write a policy and all its training needs to go on bit for bit; all or nothing.

    To be called between two updates: rollout buffers are not saved.

    :param model: the learner, on an :class:`~ogmp_sb3.adapters.OgmpVecEnv`
    :param folder: the directory to make; an existing one is replaced
    :param info: plain data for ``policy.json``: the task and how the policy came about
    :param statistics: plain data of the logs, given back by :func:`load_trainer`
    :param average: weights of the policy that is kept, if they are not those that the training goes on from
    :raises OSError: if it cannot be written
    """
    temporary = fresh(folder)
    _write(model, temporary, info, statistics or {}, average)
    put_in_place(temporary, folder)


def try_checkpoint(model: RecurrentPPO, folder: Path) -> None:
    """Write a checkpoint and throw it away, to know at the start that later ones can be written.

    :raises OSError: if it cannot be written
    """
    temporary = fresh(folder)
    try:
        _write(model, temporary, {}, {}, None)
    finally:
        remove(temporary)


def _write(
    model: RecurrentPPO, folder: Path, info: dict[str, Any], statistics: dict[str, Any], average: Weights | None
) -> None:
    env = model.env
    assert isinstance(env, OgmpVecEnv)
    tensors, plain = state(model)
    last = model.policy.state_dict()
    if average is not None:
        tensors |= {f"{LAST}{name}": tensor for name, tensor in last.items()}
    save_tensors(folder / WEIGHTS, average or last)
    save_json(folder / INFO, {"format": FORMAT, "network": _network(model.policy), **info})
    save_tensors(folder / TRAINER[0], tensors)
    save_json(folder / TRAINER[1], {**plain, "statistics": statistics})
    if env.batch.task.uses_latent and env.batch.task.encoder:
        copy_encoder(env.batch.task.encoder, folder / ENCODER)
    write_manifest(folder)


def load_trainer(model: RecurrentPPO, folder: Path) -> dict[str, Any]:
    """Put a checkpoint's weights, optimiser, generators and simulations into a fresh learner.

    :param model: a learner with the same network, task and number of environments
    :param folder: the checkpoint
    :return: the statistics given to :func:`save_checkpoint`
    :raises ValueError: if the checkpoint is damaged or does not fit
    """
    verify(folder, WEIGHTS, INFO, *TRAINER)
    tensors, plain = load_tensors(folder / TRAINER[0]), load_json(folder / TRAINER[1])
    last = {name.removeprefix(LAST): tensor for name, tensor in tensors.items() if name.startswith(LAST)}
    _put_weights(model.policy, last or policy_weights(folder), folder)
    try:
        set_state(model, tensors, plain)
        return read(dict[str, Any], plain.get("statistics"), Where(TRAINER[1], "statistics"))
    except ValueError as error:
        raise ValueError(f"{folder}: {' or '.join(TRAINER)} does not fit this run ({error}).") from None


def copy_policy(checkpoint: Path, folder: Path) -> None:
    """Copy what a policy needs out of a checkpoint, all or nothing; an existing copy is replaced.

    :raises OSError: if it cannot be written
    """
    temporary = fresh(folder)
    for name in (WEIGHTS, INFO):
        shutil.copy(checkpoint / name, temporary / name)
    if (checkpoint / ENCODER).is_dir():
        copy_encoder(str(checkpoint / ENCODER), temporary / ENCODER)
    write_manifest(temporary)
    put_in_place(temporary, folder)


def load_policy(run: str | Path, trust: bool = False, task: str | None = None) -> LoadedPolicy:
    """Load a policy by the name of a shipped one, a policy or checkpoint directory, or a run directory.

    :param trust: also load SB3's ``.zip`` of a :class:`RecurrentPPO`, which can run any code
    :param task: of a ``.zip``, which does not say it: a shipped task or the path of a YAML file
    :raises ValueError: if the files are damaged, or can run code without ``trust``
    :raises KeyError: if there is no such policy
    """
    if Path(run).is_file():
        return _imported(Path(run), trust, task)
    if task is not None:
        raise ValueError(f"'task' goes with an SB3 .zip only: the policy '{run}' knows its task.")
    folder = policy_dir(run)
    if (folder / MANIFEST).is_file():
        verify(folder, WEIGHTS, INFO)
    file = folder / INFO
    info, where = load_json(file), Where(str(file))
    if info.get("format") != FORMAT:
        raise ValueError(f"{file}: format {info.get('format')!r}, expected {FORMAT}.")
    try:
        task_data = read(dict[str, Any], info.get("task"), where / "task")
        path = Path(read(str, info.get("task_file"), where / "task_file"))
        network = read(Network, info.get("network"), where / "network")
        for key, kind in KNOWN.items():
            read(kind, info.get(key), where / key)  # type: ignore[arg-type]
        if (folder / ENCODER).is_dir():
            task_data["encoder"] = str(_lasting(folder) / ENCODER)
        task_config = task_from_data(task_data, path)
    except (KeyError, TypeError, ValueError) as error:
        said = str(error.args[0])
        raise ValueError(said if said.startswith(str(file)) else f"{file}: {said}") from None
    weights = policy_weights(folder)
    try:
        network.check(weights)
    except ValueError as error:
        raise ValueError(f"{file}: 'network' does not fit {WEIGHTS} ({error}).") from None
    scale = np.array(network.scale, dtype=np.float32)
    policy = LstmPolicy(
        spaces.Box(-CLIP * scale, CLIP * scale, dtype=np.float32),
        spaces.Box(-1.0, 1.0, (network.actions,), np.float32),
        lambda _: 0.0,
        **policy_kwargs(scale, network.kwargs.lstm_hidden_size, network.kwargs.n_lstm_layers),
    )
    _put_weights(policy, weights, folder)
    policy.set_training_mode(False)
    return LoadedPolicy(policy, task_config, task_data, path, info, folder)


def _lasting(folder: Path) -> Path:
    """Where the encoder of a policy stays: in its run, if it is the same there, for checkpoints go while it trains."""
    run = folder.parent.parent if folder.parent.name == CHECKPOINTS else folder.parent
    files = [file.name for file in (folder / ENCODER).iterdir()]
    same = filecmp.cmpfiles(folder / ENCODER, run / ENCODER, files, shallow=False)[0]
    return run if len(same) == len(files) else folder


def _imported(file: Path, trust: bool, task: str | None) -> LoadedPolicy:
    """A policy from SB3's ``.zip``."""
    policy, samples = load_zip(file, trust, task)
    path = task_path(str(task))
    data = read_yaml(path)
    return LoadedPolicy(policy, task_from_data(data, path), data, path, {"num_timesteps": samples}, file)


def policy_weights(folder: Path) -> Weights:
    """The weights of a policy from its directory, all of them finite.

    :raises ValueError: if they are not, or cannot be read
    """
    tensors = load_tensors(folder / WEIGHTS)
    for name, tensor in tensors.items():
        if not th.isfinite(tensor).all():
            raise ValueError(f"{folder / WEIGHTS}: '{name}' holds numbers that are not finite.")
    return tensors


def policy_dir(run: str | Path) -> Path:
    """The directory that holds ``policy.json``: a directory that is there, or else that of a shipped policy.

    :raises KeyError: if there is none
    """
    path = Path(run)
    if (path / INFO).is_file():
        return path
    if (path / CHECKPOINTS).is_dir():
        return latest_checkpoint(path)
    if path.is_dir():
        raise KeyError(f"'{run}' is a directory here, but neither a run nor a policy.")
    shipped = POLICIES_DIR / str(run)
    if len(path.parts) == 1 and (shipped / INFO).is_file():
        return shipped
    names = [p.parent.name for p in POLICIES_DIR.glob(f"*/{INFO}")]
    raise KeyError(f"'{run}' is neither a run directory nor a shipped policy{did_you_mean(str(run), names)}")


def checkpoint_dirs(run_dir: Path) -> list[Path]:
    """All checkpoints of a run, oldest first."""
    found = (run_dir / CHECKPOINTS).glob("[0-9]*")
    return sorted(p for p in found if p.name.isdecimal() and (p / INFO).is_file())


def checkpoint_info(folder: Path) -> dict[str, Any]:
    """What the ``policy.json`` of a checkpoint says: the task, the samples, the mean return, the versions.

    :raises ValueError: if it is damaged or missing
    """
    return load_json(folder / INFO)


def latest_checkpoint(run_dir: Path) -> Path:
    """The newest checkpoint that is whole; damaged ones are passed over with a warning.

    :raises KeyError: if the run has none
    """
    for folder in reversed(checkpoint_dirs(run_dir)):
        try:
            verify(folder, WEIGHTS, INFO, *TRAINER)
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


def _put_weights(policy: Any, weights: Weights, folder: Path) -> None:
    try:
        policy.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"{folder / WEIGHTS}: {' '.join(str(error).split())[:200]}") from None
