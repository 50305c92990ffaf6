"""The LSTM auto-encoder of references: its data, its model and its training (paper, sec. III-C)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors.torch import save
from torch import nn

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.latent import FEATURES, FORMAT, LATENT_SIZE, reference_features
from ogmp_sb3.guidance.plans import make_oracle, segment_set_points, start_state
from ogmp_sb3.guidance.sampling import ModeCall, draw_parameters, flat_ground
from ogmp_sb3.guidance.srb import POS, VEL

HIDDEN = 32
BATCH = 64
RUN_OUT = 5.0  # m of flat ground behind the mode
SPREAD = 0.5  # m/s: initial velocities differ this much from the set-points', both ways (released code)


@dataclass(frozen=True)
class ReferenceData:
    """References of single modes, balanced over modes."""

    state: np.ndarray
    """shape (n, knots + 1, 12), padded behind each row's steps"""
    steps: np.ndarray
    """shape (n,), int"""
    calls: list[ModeCall]
    """the mode and parameters of each"""


def reference_data(task: TaskConfig, per_mode: int, seed: int) -> ReferenceData:
    """Ask the task's oracle for references with uniform mode parameters and initial states.

    The robot is somewhere on the run-up of a mode, with another height and velocity than the set-points'.

    :param per_mode: references of each mode
    :param seed: of the draw
    """
    rng = np.random.default_rng(seed)
    oracle = make_oracle(task)
    states, steps, calls = [], [], []
    for name, ranges in task.mode_ranges.items():
        for _ in range(per_mode):
            call = ModeCall(name, draw_parameters(ranges, rng))
            segment = call.segment()
            segments, x0 = [segment], start_state(task, segment)
            if segment.timed:
                length = max(round(segment.spans[-1].end / task.control_dt), 1)
            else:
                assert task.horizon is not None
                length = task.horizon
                speed = segment.spans[0].velocity[0]
                segments.append(flat_ground(speed, RUN_OUT).segment())
                x0[0, VEL.start] = speed + rng.uniform(-SPREAD, SPREAD)
                x0[0, VEL.start + 2] = rng.uniform(-SPREAD, SPREAD)
                x0[0, POS.start + 2] += rng.uniform(-0.05, 0.1)
            states.append(oracle(segment_set_points(task, segments, x0, length), x0).state[0])
            steps.append(length)
            calls.append(call)
    longest = max(steps)
    padded = [np.pad(s, ((0, longest + 1 - len(s)), (0, 0)), mode="edge") for s in states]
    return ReferenceData(np.stack(padded), np.array(steps), calls)


class AutoEncoder(nn.Module):
    """LSTM 13 -> 32, ReLU, LSTM 32 -> 2; its last hidden state repeated, LSTM 2 -> 32, ReLU, LSTM 32 -> 32, linear.

    :param mean: of the features, shape (13,)
    :param std: of the features, shape (13,)
    """

    mean: th.Tensor
    std: th.Tensor

    def __init__(self, mean: np.ndarray, std: np.ndarray) -> None:
        super().__init__()
        self.register_buffer("mean", th.as_tensor(mean, dtype=th.float32))
        self.register_buffer("std", th.as_tensor(std, dtype=th.float32))
        self.encoder_in = nn.LSTM(FEATURES, HIDDEN, batch_first=True)
        self.encoder_out = nn.LSTM(HIDDEN, LATENT_SIZE, batch_first=True)
        self.decoder_in = nn.LSTM(LATENT_SIZE, HIDDEN, batch_first=True)
        self.decoder_out = nn.LSTM(HIDDEN, HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, FEATURES, bias=False)

    def encode(self, features: th.Tensor, steps: th.Tensor) -> th.Tensor:
        """Latents of normalised features (n, knots + 1, 13), shape (n, 2)."""
        hidden, _ = self.encoder_in(features)
        latent, _ = self.encoder_out(th.relu(hidden))
        last: th.Tensor = latent[th.arange(len(steps)), steps]
        return last

    def forward(self, features: th.Tensor, steps: th.Tensor) -> th.Tensor:
        """Reconstruction of normalised features, shape (n, knots + 1, 13)."""
        repeated = self.encode(features, steps)[:, None].expand(-1, features.shape[1], -1)
        hidden, _ = self.decoder_in(repeated)
        hidden, _ = self.decoder_out(th.relu(hidden))
        return self.head(hidden)  # type: ignore[no-any-return]


def fit(
    data: ReferenceData, updates: int, seed: int, report: Callable[[int, float], None] = lambda update, loss: None
) -> AutoEncoder:
    """Train an auto-encoder: Adam with a falling rate, gradients clipped to norm 1. Same seed, same result.

    :param updates: minibatches of ``BATCH`` references
    :param report: called after every update with its number and the loss: the share of the variance not explained
    """
    features = reference_features(data.state)
    mask = np.arange(features.shape[1]) <= data.steps[:, None]
    mean = features[mask].mean(axis=0)
    # One scale for all features, so that metres, metres per second and quaternions weigh as they are.
    std = np.full(FEATURES, np.sqrt(features[mask].var(axis=0).mean()))
    x = th.as_tensor((features - mean) / std, dtype=th.float32)
    steps, valid = th.as_tensor(data.steps), th.as_tensor(mask)
    with th.random.fork_rng():
        th.manual_seed(seed)
        model = AutoEncoder(mean, std)
        optimiser = th.optim.Adam(model.parameters(), lr=5e-3)
        schedule = th.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, 1e-4)
        for update in range(updates):
            rows = th.randint(len(x), (BATCH,))
            optimiser.zero_grad()
            loss = ((model(x[rows], steps[rows]) - x[rows]) ** 2)[valid[rows]].mean()
            loss.backward()
            th.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            report(update, loss.item())
    return model


def reconstruction_error(model: AutoEncoder, data: ReferenceData) -> float:
    """Mean squared error over that of predicting the mean: 0 is perfect, 1 useless."""
    features = reference_features(data.state)
    mask = np.arange(features.shape[1]) <= data.steps[:, None]
    x = (th.as_tensor(features, dtype=th.float32) - model.mean) / model.std
    with th.no_grad():
        error = ((model(x, th.as_tensor(data.steps)) - x) ** 2)[mask].mean()
    return float(error / x[mask].var(dim=0).mean())


def nearest_mode_accuracy(train: np.ndarray, train_modes: list[str], test: np.ndarray, test_modes: list[str]) -> float:
    """Share of test latents whose nearest training latent is of the same mode.

    :param train: shape (n, 2)
    :param test: shape (m, 2)
    """
    distance = np.linalg.norm(test[:, None] - train[None], axis=-1)
    nearest = distance.argmin(axis=1)
    return float(np.mean([train_modes[i] == mode for i, mode in zip(nearest, test_modes, strict=True)]))


def save_encoder(model: AutoEncoder, folder: Path, info: dict[str, Any]) -> None:
    """Write ``encoder.safetensors`` and ``encoder.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {k: v.contiguous() for k, v in model.state_dict().items()}
    (folder / "encoder.safetensors").write_bytes(save(tensors))  # readable as the umask says, unlike by save_file
    (folder / "encoder.json").write_text(json.dumps({"format": FORMAT, **info}, indent=1), encoding="utf-8")
