"""The LSTM auto-encoder of references: its model, its training and how much it keeps (paper, sec. III-C)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors.torch import load_file, save
from scipy.spatial import cKDTree
from torch import nn

from ogmp_sb3.guidance.latent import FEATURES, FORMAT, LATENT_SIZE, encoder_dir, reference_features
from ogmp_sb3.guidance.reference_data import ReferenceData

HIDDEN = 32
BATCH = 64
CHUNK = 1024  # references that are reconstructed together


class AutoEncoder(nn.Module):
    """LSTM 13 -> 32, ReLU, LSTM 32 -> n; its last hidden state repeated, LSTM n -> 32, ReLU, LSTM 32 -> 32, linear.

    :param mean: of the features, shape (13,)
    :param std: of the features, shape (13,)
    :param latent_size: n
    """

    mean: th.Tensor
    std: th.Tensor

    def __init__(self, mean: np.ndarray, std: np.ndarray, latent_size: int = LATENT_SIZE) -> None:
        super().__init__()
        self.register_buffer("mean", th.as_tensor(mean, dtype=th.float32))
        self.register_buffer("std", th.as_tensor(std, dtype=th.float32))
        self.encoder_in = nn.LSTM(FEATURES, HIDDEN, batch_first=True)
        self.encoder_out = nn.LSTM(HIDDEN, latent_size, batch_first=True)
        self.decoder_in = nn.LSTM(latent_size, HIDDEN, batch_first=True)
        self.decoder_out = nn.LSTM(HIDDEN, HIDDEN, batch_first=True)
        self.head = nn.Linear(HIDDEN, FEATURES, bias=False)

    def encode(self, features: th.Tensor, steps: th.Tensor) -> th.Tensor:
        """Latents of normalised features (n, knots + 1, 13), shape (n, latent size)."""
        hidden, _ = self.encoder_in(features)
        latent, _ = self.encoder_out(th.relu(hidden))
        last: th.Tensor = latent[th.arange(len(steps)), steps]
        return last

    def decode(self, latent: th.Tensor, knots: int) -> th.Tensor:
        """Reconstruction of normalised features from latents, shape (n, knots, 13)."""
        hidden, _ = self.decoder_in(latent[:, None].expand(-1, knots, -1))
        hidden, _ = self.decoder_out(th.relu(hidden))
        return self.head(hidden)  # type: ignore[no-any-return]


def fit(
    data: ReferenceData,
    updates: int,
    seed: int,
    latent_size: int = LATENT_SIZE,
    report: Callable[[int, float], None] = lambda update, loss: None,
) -> AutoEncoder:
    """Train an auto-encoder: Adam with a falling rate, gradients clipped to norm 1. Same seed, same result.

    :param updates: minibatches of ``BATCH`` references
    :param latent_size: how many numbers a latent is
    :param report: called after every update with its number and the loss: the share of the variance not explained
    """
    features, mask = reference_features(data.state), data.mask
    mean = features[mask].mean(axis=0)
    # One scale for all features, so that metres, metres per second and quaternions weigh as they are.
    std = np.full(FEATURES, np.sqrt(features[mask].var(axis=0).mean()))
    x = th.as_tensor((features - mean) / std, dtype=th.float32)
    steps, valid = th.as_tensor(data.steps), th.as_tensor(mask)
    with th.random.fork_rng():
        th.manual_seed(seed)
        model = AutoEncoder(mean, std, latent_size)
        optimiser = th.optim.Adam(model.parameters(), lr=5e-3)
        schedule = th.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, 1e-4)
        for update in range(updates):
            rows = th.randint(len(x), (BATCH,))
            optimiser.zero_grad()
            decoded = model.decode(model.encode(x[rows], steps[rows]), x.shape[1])
            loss = ((decoded - x[rows]) ** 2)[valid[rows]].mean()
            loss.backward()  # type: ignore[no-untyped-call]
            th.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            report(update, loss.item())
    return model


@dataclass(frozen=True)
class LatentQuality:
    """How much an auto-encoder keeps of references that it was not trained on."""

    unexplained: float
    """mean squared error over that of predicting the mean: 0 is perfect, 1 useless"""
    same_mode: float
    """share of the references whose nearest other latent belongs to the same mode"""
    references: int
    """how many"""

    def __str__(self) -> str:
        mode = f"the nearest other latent is of the same mode for {self.same_mode:.1%}"
        return f"{self.unexplained:.1%} of the variance is not explained, and {mode}"


def latent_quality(model: AutoEncoder, known: ReferenceData, test: ReferenceData) -> LatentQuality:
    """How much of some references a latent keeps.

    :param known: references whose latents are the neighbours, e.g. those of the training
    :param test: references that are none of them
    """
    latents, error = _reconstruct(model, test)
    variance = reference_features(test.state)[test.mask].var(axis=0).sum()
    nearest = known.modes[cKDTree(_reconstruct(model, known)[0]).query(latents)[1]]
    same = float(np.mean(nearest == test.modes))
    return LatentQuality(error / float(variance), same, len(test.steps))


def _reconstruct(model: AutoEncoder, data: ReferenceData) -> tuple[np.ndarray, float]:
    """Latents, shape (n, latent size), and the mean squared error of a knot, summed over the features."""
    features, latents, error = reference_features(data.state), [], 0.0
    for begin in range(0, len(features), CHUNK):
        part = slice(begin, begin + CHUNK)
        with th.no_grad():
            x = (th.as_tensor(features[part], dtype=th.float32) - model.mean) / model.std
            latents.append(model.encode(x, th.as_tensor(data.steps[part])))
            decoded = model.decode(latents[-1], x.shape[1]) * model.std + model.mean
        error += float(((decoded.numpy() - features[part]) ** 2)[data.mask[part]].sum())
    return th.cat(latents).numpy(), error / int(data.mask.sum())


def save_encoder(model: AutoEncoder, folder: Path, info: dict[str, Any]) -> None:
    """Write ``encoder.safetensors`` and ``encoder.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {k: v.contiguous() for k, v in model.state_dict().items()}
    (folder / "encoder.safetensors").write_bytes(save(tensors))  # readable as the umask says, unlike by save_file
    described = {"format": FORMAT, "latent_size": model.encoder_out.hidden_size, **info}
    (folder / "encoder.json").write_text(json.dumps(described, indent=1), encoding="utf-8")


def load_auto_encoder(name_or_path: str) -> AutoEncoder | None:
    """The whole auto-encoder of an encoder that :func:`~ogmp_sb3.guidance.latent.load_encoder` loads.

    :return: None if its file holds no decoder, or one of another form
    """
    tensors = load_file(encoder_dir(name_or_path) / "encoder.safetensors")
    mean, std = tensors["mean"].numpy(), tensors["std"].numpy()
    model = AutoEncoder(mean, std, tensors["encoder_out.weight_hh_l0"].shape[1])
    try:
        model.load_state_dict(tensors)
    except RuntimeError:
        return None
    return model
