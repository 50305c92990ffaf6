"""Trained policies: loaded by name, or from wherever a training or a user keeps them."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces

from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.env.observations import CLIP
from ogmp_sb3.env.robot_digest import robot_digest
from ogmp_sb3.guidance.latent import changed_file, encoder_dir
from ogmp_sb3.runs.checkpoint import FORMAT, latest_checkpoint, policy_weights, put_weights
from ogmp_sb3.runs.hub import PREFIX, hub_folder, hub_name
from ogmp_sb3.runs.robot_copy import original, read_record, task_robot, warn_of_changes
from ogmp_sb3.runs.run_directory import CHECKPOINTS, CONFIG, ENCODER, INFO, WEIGHTS
from ogmp_sb3.runs.run_folders import is_run
from ogmp_sb3.runs.run_names import find_run
from ogmp_sb3.runs.sb3_zip import load_zip
from ogmp_sb3.runs.storage import MANIFEST, check_shapes, load_json, verify
from ogmp_sb3.sb3.policy import LstmPolicy, policy_kwargs

KNOWN = {"num_timesteps": int | None, "return": float | None, "versions": dict[str, str] | None}  # in policy.json


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
        """Name of the directory, of the ``.zip`` without its ending, or of the repository on the Hub."""
        return self.path.stem if self.path.is_file() else hub_name(self.path) or self.path.name

    @property
    def files(self) -> tuple[Path, ...]:
        """What the policy is made of; the weights first."""
        return (self.path,) if self.path.is_file() else (self.path / WEIGHTS, self.path / INFO)

    @property
    def digest(self) -> str:
        """Identifies the policy and its task: the beginning of the SHA-256 of its files, its encoder's, the task's
        data, and what its robot is in a simulation. The paths that they were found by do not matter.
        """
        latent = self.task.uses_latent and self.task.encoder
        encoder = sorted(encoder_dir(latent).iterdir()) if latent else []
        task = json.dumps({**self.task_data, "encoder": None, "robot": None}, sort_keys=True)
        parts = [file.read_bytes() for file in (*self.files, *encoder)]
        parts += [text.encode() for text in (robot_digest(self.task.robot_config), task)]
        return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def load_policy(
    run: str | Path, trust: bool = False, task: str | None = None, robot: str | Path | None = None
) -> LoadedPolicy:
    """Load a policy by name (:mod:`~ogmp_sb3.runs.run_names`), by the directory of a policy, a checkpoint or a run, or
    from the Hugging Face Hub (``hf:<owner>/<name>``).

    Its robot is the copy that the run or the policy has of it; one sentence warns if the original has changed since.

    :param trust: also load SB3's ``.zip`` of a :class:`RecurrentPPO`, which can run any code
    :param task: of a ``.zip``, which does not say it: a shipped task or the path of a YAML file
    :param robot: another robot in place of its own: a name, or the path of a robot.yaml
    :raises ValueError: if the files are damaged, or can run code without ``trust``, or the robot is nowhere
    :raises KeyError: if there is no such policy
    """
    given = None if robot is None else find("robot", robot).absolute()
    if Path(run).is_file():
        return _imported(Path(run), trust, task, given)
    if task is not None:
        raise ValueError(f"'task' goes with an SB3 .zip only: the policy '{run}' knows its task.")
    folder = policy_dir(run)
    if (folder / MANIFEST).is_file():
        verify(folder, WEIGHTS, INFO)
    info, config, data, path, network = _read_info(folder, given)
    return LoadedPolicy(_policy(network, folder), config, data, path, info, folder)


def _read_info(folder: Path, robot: Path | None) -> tuple[dict[str, Any], TaskConfig, dict[str, Any], Path, Network]:
    """What ``policy.json`` says: all of it, the task, its data and its file, and the sizes of the networks."""
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
        name, record, run = task_data.get("robot"), read_record(info, where), _run(folder)
        if isinstance(name, str):
            task_data["robot"] = str(robot or task_robot(name, path, record, run, folder))
        task = task_from_data(task_data, path)
    except (KeyError, TypeError, ValueError) as error:
        reason = str(error.args[0])
        raise ValueError(reason if reason.startswith(str(file)) else f"{file}: {reason}") from None
    if robot is None:
        place = original(str(name), path, record, run)
        warn_of_changes(task.robot_config, place, record, f"; robot={place} takes the new one", stacklevel=4)
    return info, task, task_data, path, network


def _policy(network: Network, folder: Path) -> LstmPolicy:
    """A policy of the given sizes with the weights in a directory."""
    weights = policy_weights(folder)
    try:
        network.check(weights)
    except ValueError as error:
        raise ValueError(f"{folder / INFO}: 'network' does not fit {WEIGHTS} ({error}).") from None
    scale, size = np.array(network.scale, dtype=np.float32), network.kwargs
    policy = LstmPolicy(
        spaces.Box(-CLIP * scale, CLIP * scale, dtype=np.float32),
        spaces.Box(-1.0, 1.0, (network.actions,), np.float32),
        lambda _: 0.0,
        **policy_kwargs(
            scale,
            size.lstm_hidden_size,
            size.n_lstm_layers,
            input_layers=size.input_layers,
            critic_layers=size.critic_layers,
            critic_inputs=size.critic_inputs,
        ),
    )
    put_weights(policy, weights, folder)
    policy.set_training_mode(False)
    return policy


def _lasting(folder: Path) -> Path:
    """Where the encoder of a policy stays: in its run, if it is the same there, for checkpoints go while it trains."""
    run = _run(folder)
    return folder if run is None or changed_file(folder / ENCODER, run / ENCODER) else run


def _run(folder: Path) -> Path | None:
    """The run directory of a policy; None if it is alone."""
    folder = folder.absolute()
    run = folder.parent.parent if folder.parent.name == CHECKPOINTS else folder.parent
    return run if (run / CONFIG).is_file() else None


def _imported(file: Path, trust: bool, task: str | None, robot: Path | None) -> LoadedPolicy:
    """A policy from SB3's ``.zip``."""
    policy, samples = load_zip(file, trust, task)
    path = find("task", str(task))
    data = read_task(path)
    if robot is not None:
        data["robot"] = str(robot)
    return LoadedPolicy(policy, task_from_data(data, path), data, path, {"num_timesteps": samples}, file)


def policy_dir(run: str | Path) -> Path:
    """The directory that holds ``policy.json``: that of a policy, or of the latest checkpoint of a run.

    :param run: a path or a name, as :mod:`~ogmp_sb3.runs.run_names` has it
    :raises KeyError: if there is none
    :raises ValueError: if the name is that of several, or the policy is to be on the Hub and is not
    """
    name = find_run(str(run))
    if name.startswith(PREFIX):
        return hub_folder(name)
    path = Path(name)
    if not (path / INFO).is_file() and (is_run(path) or (path / CHECKPOINTS).is_dir()):
        return latest_checkpoint(path)
    return find("policy", path).parent


@dataclass(frozen=True, kw_only=True)
class NetworkSize:
    """The LSTMs of actor and critic."""

    lstm_hidden_size: int
    """of each layer"""
    n_lstm_layers: int
    """of each network"""
    input_layers: tuple[int, ...] = ()
    """units of each layer in front of them"""
    critic_layers: tuple[int, ...] | None = None
    """units of each layer of a critic without memory; null: the critic has an LSTM too"""
    critic_inputs: int = 0
    """how many values the critic sees beside the observation"""


@dataclass(frozen=True, kw_only=True)
class Network:
    """Sizes and scales of a network, from which it is built before its weights are loaded."""

    scale: tuple[float, ...]
    """typical sizes of the observation's components"""
    actions: int
    """length of an action"""
    kwargs: NetworkSize
    """of the LSTMs"""

    def check(self, weights: dict[str, th.Tensor]) -> None:
        """Compare the sizes with the shapes of the weights, before a network of these sizes is built.

        :raises ValueError: if they differ
        """
        hidden, last = self.kwargs.lstm_hidden_size, self.kwargs.n_lstm_layers - 1
        lstm, layers = "lstm_actor.lstm" if self.kwargs.input_layers else "lstm_actor", self.kwargs.input_layers
        critic = self.kwargs.critic_layers
        expected = {
            "features_extractor.mean": (len(self.scale),),
            f"{lstm}.weight_hh_l{last}": (4 * hidden, hidden),
            **{f"lstm_actor.layers.{2 * k}.bias": (units,) for k, units in enumerate(layers)},
            **{f"critic.{2 * k}.bias": (units,) for k, units in enumerate(critic or ())},
            **({"critic.0.weight": (critic[0], len(self.scale) + self.kwargs.critic_inputs)} if critic else {}),
            "action_net.bias": (self.actions,),
        }
        check_shapes(expected, weights)
