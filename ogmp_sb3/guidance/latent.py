"""The mode latent: what a trained encoder makes of a reference (paper, sec. III-C: z = xi(x[t, t + dt])).

Only inference, compiled, so that a handful of references at every control step costs next to nothing; the encoder
is trained in :mod:`ogmp_sb3.guidance.encoder_training`.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.guidance.rotations import rpy_to_quat
from ogmp_sb3.guidance.srb import OMEGA, POS, RPY, VEL
from ogmp_sb3.machine import compiled

LATENT_SIZE = 2  # of the paper
FEATURES = 13
FORMAT = 1


@dataclass(frozen=True)
class LatentEncoder:
    """A trained encoder: LSTM 13 -> 32, ReLU, LSTM 32 -> n; the latent is the last hidden state, in (-1, 1)."""

    mean: np.ndarray
    """of the features, shape (13,)"""
    std: np.ndarray
    """of the features, shape (13,)"""
    weights: tuple[np.ndarray, ...]
    """input, recurrent and bias weights of both LSTMs, shapes (inputs, gates) and (gates,), gates in torch's order"""
    info: dict[str, Any] = field(default_factory=dict)
    """what ``encoder.json`` says of its training"""

    @property
    def size(self) -> int:
        """How many numbers a latent is."""
        return len(self.weights[4])

    def __call__(self, state: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Encode references.

        :param state: shape (rows, knots + 1, 12)
        :param steps: how many steps of each row are meant, shape (rows,), int
        :return: shape (rows, size)
        """
        features = (reference_features(state) - self.mean) / self.std
        return _encode(features, steps, *self.weights)  # type: ignore[no-any-return]


def reference_features(state: np.ndarray) -> np.ndarray:
    """What the encoder sees of a reference: position with x from its start, quaternion, linear and angular velocity.

    :param state: shape (rows, knots + 1, 12)
    :return: shape (rows, knots + 1, 13)
    """
    position = state[..., POS].copy()
    position[..., 0] -= position[..., :1, 0]
    return np.concatenate([position, rpy_to_quat(state[..., RPY]), state[..., VEL], state[..., OMEGA]], axis=-1)


def load_encoder(name_or_path: str) -> LatentEncoder:
    """Load an encoder by the name of one in ``./encoders``, a shipped one or one of a plug-in, or by its directory.

    :raises KeyError: if there is none
    :raises ValueError: if its files are damaged
    """
    folder = encoder_dir(name_or_path)
    try:
        info: dict[str, Any] = json.loads((folder / "encoder.json").read_text(encoding="utf-8"))
        tensors = load_file(folder / "encoder.safetensors")
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']}, expected {FORMAT}")
        weights = []
        for lstm in ("encoder_in", "encoder_out"):
            weights += [tensors[f"{lstm}.weight_ih_l0"], tensors[f"{lstm}.weight_hh_l0"]]
            weights.append(tensors[f"{lstm}.bias_ih_l0"] + tensors[f"{lstm}.bias_hh_l0"])
        mean, std = tensors["mean"].astype(float), tensors["std"].astype(float)
        size = len(tensors["encoder_out.weight_hh_l0"][0])
        if info.get("latent_size", size) != size:
            raise ValueError(f"latent_size is {info['latent_size']}, and there are weights for {size}")
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise ValueError(f"{folder}: not a readable encoder ({error}).") from None
    return LatentEncoder(mean, std, tuple(np.ascontiguousarray(w.T, dtype=float) for w in weights), info)


def task_encoder(task: TaskConfig) -> LatentEncoder | None:
    """The task's encoder, if its latent is observed.

    :raises ValueError: if the latent is observed but no encoder is named
    :raises KeyError: if there is no such encoder
    """
    if not task.uses_latent:
        return None
    if task.encoder is None:
        raise ValueError(f"{task.file}: observation 'mode_latent' needs an 'encoder' (ogmp-encode trains one).")
    return load_encoder(task.encoder)


def encoder_dir(name_or_path: str) -> Path:
    """Where an encoder is. Raises as :func:`load_encoder`."""
    return find("encoder", name_or_path).parent


def copy_encoder(name_or_path: str, folder: Path) -> None:
    """Copy an encoder's two files into a directory, so that what was trained with it keeps it."""
    source = encoder_dir(name_or_path)
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("encoder.json", "encoder.safetensors"):
        shutil.copyfile(source / name, folder / name)


def changed_file(saved: Path, used: Path) -> str | None:
    """The name of a file of an encoder that is not the same in another directory; None if all are."""
    for file in saved.iterdir():
        if not (used / file.name).is_file() or (used / file.name).read_bytes() != file.read_bytes():
            return file.name
    return None


@compiled(fastmath=True)
def _encode(features, steps, wi1, wh1, b1, wi2, wh2, b2):  # type: ignore[no-untyped-def]
    """Every row by itself: a matrix product over all of them would round by how many there are, and by the padding."""
    rows, hidden, size = len(features), len(wh1), len(wh2)
    latent = np.zeros((rows, size))
    for row in range(rows):
        h1, c1, h2, c2 = np.zeros(hidden), np.zeros(hidden), np.zeros(size), np.zeros(size)
        for k in range(steps[row] + 1):
            gates1, gates2 = b1.copy(), b2.copy()
            _add_product(gates1, wi1, features[row, k])
            _add_product(gates1, wh1, h1)
            _lstm_step(gates1, h1, c1)
            _add_product(gates2, wi2, np.maximum(h1, 0.0))
            _add_product(gates2, wh2, h2)
            _lstm_step(gates2, h2, c2)
        latent[row] = h2
    return latent


@compiled(fastmath=True)
def _add_product(gates, weights, x):  # type: ignore[no-untyped-def]
    """``gates += x weights``, in place; weights have shape (inputs, gates), so that the inner loop is contiguous."""
    for i in range(len(x)):
        for j in range(len(gates)):
            gates[j] += x[i] * weights[i, j]


@compiled(fastmath=True)
def _lstm_step(gates, h, c):  # type: ignore[no-untyped-def]
    """One step of an LSTM, in place; gates in the order input, forget, cell, output, as in torch."""
    n = len(h)
    for j in range(n):
        i, f = 0.5 + 0.5 * _tanh(0.5 * gates[j]), 0.5 + 0.5 * _tanh(0.5 * gates[n + j])
        g, o = _tanh(gates[2 * n + j]), 0.5 + 0.5 * _tanh(0.5 * gates[3 * n + j])
        c[j] = f * c[j] + i * g
        h[j] = o * _tanh(c[j])


@compiled(fastmath=True)
def _tanh(x):  # type: ignore[no-untyped-def]
    """tanh as a continued fraction, which the compiler can vectorise; the error is below 1e-6."""
    x = min(max(x, -8.0), 8.0)
    # Halving the argument twice keeps the fraction in the range where it is exact to 1e-9.
    y = 0.25 * x
    s = y * y
    t = y * (10395.0 + s * (1260.0 + s * 21.0)) / (10395.0 + s * (4725.0 + s * (210.0 + s)))
    t = 2.0 * t / (1.0 + t * t)
    return 2.0 * t / (1.0 + t * t)
