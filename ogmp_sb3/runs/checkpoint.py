"""Policies and trainings on disk: safetensors, JSON, YAML and MJCF, nothing that can run code.

A policy is a directory with ``policy.safetensors`` (weights and normaliser), ``policy.json`` (its task and network),
``robot/`` if the robot's files are small (:mod:`ogmp_sb3.runs.robot_copy`) and, if it observes the mode latent,
``encoder/``. A checkpoint of a training is such a directory with ``trainer.safetensors`` and ``trainer.json`` beside,
which hold everything else that the next step depends on, and ``manifest.json`` with the checksums.
"""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path
from typing import Any

import torch as th

from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.guidance.latent import copy_encoder
from ogmp_sb3.runs.atomic import fresh, put_in_place, remove
from ogmp_sb3.runs.learner_state import set_state, state
from ogmp_sb3.runs.robot_copy import ROBOT, copy_small
from ogmp_sb3.runs.run_directory import ENCODER, INFO, TRAINER, WEIGHTS, checkpoint_dirs
from ogmp_sb3.runs.storage import load_json, load_tensors, save_json, save_tensors, verify, write_manifest
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

FORMAT = 1
LAST = "policy."  # begins the names of the weights a training goes on from, where the policy kept is an average

Weights = dict[str, th.Tensor]


def save_checkpoint(
    model: RecurrentPPO,
    folder: Path,
    info: dict[str, Any],
    statistics: dict[str, Any] | None = None,
    average: Weights | None = None,
) -> None:
    """Write a policy and all its training needs to go on bit for bit; all or nothing.

    To be called between two updates: rollout buffers are not saved.

    :param model: the learner, on an :class:`~ogmp_sb3.sb3.vec_env.OgmpVecEnv`
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
    if info.get(ROBOT, {}).get("files"):
        copy_small(env.batch.task.robot_config.path.parent, folder)
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
    put_weights(model.policy, last or policy_weights(folder), folder)
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
        shutil.copyfile(checkpoint / name, temporary / name)
    if (checkpoint / ENCODER).is_dir():
        copy_encoder(str(checkpoint / ENCODER), temporary / ENCODER)
    if (checkpoint / ROBOT).is_dir():
        copy_small(checkpoint / ROBOT, temporary)
    write_manifest(temporary)
    put_in_place(temporary, folder)


def policy_weights(folder: Path) -> Weights:
    """The weights of a policy from its directory, all of them finite.

    :raises ValueError: if they are not, or cannot be read
    """
    tensors = load_tensors(folder / WEIGHTS)
    for name, tensor in tensors.items():
        if not th.isfinite(tensor).all():
            raise ValueError(f"{folder / WEIGHTS}: '{name}' holds numbers that are not finite.")
    return tensors


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
            "input_layers": list(policy.input_layers),
            "critic_layers": None if policy.critic_layers is None else list(policy.critic_layers),
            "critic_inputs": policy.critic_inputs,
            "lstm_hidden_size": policy.lstm_actor.hidden_size,
            "n_lstm_layers": policy.lstm_actor.num_layers,
        },
    }


def put_weights(policy: Any, weights: Weights, folder: Path) -> None:
    """:raises ValueError: if weights do not fit the policy."""
    try:
        policy.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"{folder / WEIGHTS}: {' '.join(str(error).split())[:200]}") from None
