"""Left-right symmetry: a recurrent policy that does on one side what it does on the other.

An LSTM whose hidden units come in pairs, one for each side, answers the mirror image of an observation with the mirror
image of the action, and keeps the mirror image of its memory, if its weights are their own mirror image. Gradients are
made so: each becomes the mean of itself and of its mirror image, which is the gradient on the rollout and on its mirror
image together. So every sample counts for both sides, the memory of the mirrored rollout is exact, and neither costs
an evaluation of the network. The policy itself is a plain one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.distributions import DiagGaussianDistribution

from ogmp_sb3.env.mirror import Mirror, Mirrors

GATES = 4  # of an LSTM, one behind the other in the rows of its weights
LAYERS = ".layers."  # of a LayeredLstm
CRITIC = "critic."  # one without memory


class Symmetry:
    """Keeps the weights of a policy their own mirror image.

    :param policy: of actor and critic LSTMs, and linear layers behind them
    :param mirrors: the mirror images of observations and actions
    :raises ValueError: if a layer has an odd number of units
    """

    def __init__(self, policy: Any, mirrors: Mirrors) -> None:
        self._observation = mirrors.observation
        named = dict(policy.named_parameters())
        first = (f"{LAYERS}0.weight" if any(LAYERS in name for name in named) else "weight_ih_l0", f"{CRITIC}0.weight")
        self._images = []
        for name, weight in named.items():
            inputs = None if not name.endswith(first) else mirrors.critic if "critic" in name else mirrors.observation
            source, sign = _image_of_weight(name, tuple(weight.shape), inputs, mirrors.action)
            self._images.append((weight, source.to(weight.device), sign.to(weight.device)))

    @th.no_grad()
    def symmetrise_weights(self) -> None:
        """Make the weights their own mirror image: of each two that are each other's, the first counts."""
        for weight, source, sign in self._images:
            own, values = th.arange(len(source), device=source.device), weight.flatten()
            values = th.where(source < own, sign * values[source], values)
            odd = (source == own) & (sign < 0)  # its own image, and its negative
            weight.copy_(th.where(odd, 0.0, values).view_as(weight))

    @th.no_grad()
    def symmetrise_gradients(self) -> None:
        """Make every gradient the mean of itself and of its mirror image."""
        for weight, source, sign in self._images:
            if weight.grad is not None:
                image = (sign * weight.grad.flatten()[source]).view_as(weight)
                weight.grad.add_(image).mul_(0.5)

    def both_sides(self, observations: th.Tensor) -> th.Tensor:
        """Observations, shape (n, size), and their mirror images, shape (2 n, size)."""
        return th.cat([observations, _image(observations, self._observation)])


def _image(vectors: th.Tensor, mirror: Mirror) -> th.Tensor:
    """The mirror images of vectors, shape (n, size)."""
    source = th.as_tensor(mirror.source, device=vectors.device)
    return th.as_tensor(mirror.sign, dtype=vectors.dtype, device=vectors.device) * vectors[:, source]


def _image_of_weight(
    name: str, shape: tuple[int, ...], inputs: Mirror | None, action: Mirror
) -> tuple[th.Tensor, th.Tensor]:
    """Where each entry of the mirror image of a flattened weight comes from, and its sign.

    :param inputs: the mirror image of what the layer gets; None: it gets hidden units
    """
    source, sign = _image_of_outputs(name, shape[0], action)
    if len(shape) > 1:
        inputs = inputs or _swapped_halves(name, shape[1])
        source = (source[:, None] * shape[1] + inputs.source).ravel()
        sign = (sign[:, None] * inputs.sign).ravel()
    return th.as_tensor(source), th.as_tensor(sign, dtype=th.float32)


def _image_of_outputs(name: str, size: int, action: Mirror) -> tuple[np.ndarray, np.ndarray]:
    layer = name.partition(".")[0]
    if layer == "action_net":
        return action.source, action.sign
    if layer == "log_std":
        return action.source, np.ones(size)
    if layer == "value_net":
        return np.arange(size), np.ones(size)
    blocks = GATES if layer.startswith("lstm") and LAYERS not in name else 1
    half = _swapped_halves(name, size // blocks)
    return np.concatenate([half.source + block * (size // blocks) for block in range(blocks)]), np.ones(size)


def _swapped_halves(name: str, size: int) -> Mirror:
    """The mirror image of hidden units, whose first half is of one side, and the second of the other."""
    if size % 2:
        raise ValueError(f"a symmetric policy needs an even number of hidden units; '{name}' has {size}.")
    return Mirror(np.roll(np.arange(size), size // 2), np.ones(size))


class SymmetricNoise(DiagGaussianDistribution):
    """Gaussian actions around a mean, whose noise is in part the same on both sides, and in part opposite.

    Noise that is its own mirror image does not push a symmetric robot to the side; the rest does, and may be smaller.

    :param action: the mirror image of an action
    :param asymmetric: standard deviation of what is opposite on both sides, as a multiple of that of the other part,
        above 0
    """

    def __init__(self, action: Mirror, asymmetric: float) -> None:
        super().__init__(len(action.sign))
        self._action, self._asymmetric = action, asymmetric
        own = action.sign[action.source == np.arange(len(action.sign))].sum()  # trace of the mirror
        self._log_volume = float(math.log(asymmetric) * (len(action.sign) - own) / 2)

    def proba_distribution(self, mean_actions: th.Tensor, log_std: th.Tensor) -> SymmetricNoise:
        super().proba_distribution(mean_actions, log_std)
        return self

    def sample(self) -> th.Tensor:
        mean: th.Tensor = self.distribution.mean
        return mean + self._scaled(self.distribution.rsample() - mean, self._asymmetric)

    def log_prob(self, actions: th.Tensor) -> th.Tensor:
        mean: th.Tensor = self.distribution.mean
        return super().log_prob(mean + self._scaled(actions - mean, 1.0 / self._asymmetric)) - self._log_volume

    def entropy(self) -> th.Tensor | None:
        entropy = super().entropy()
        return None if entropy is None else entropy + self._log_volume

    def _scaled(self, noise: th.Tensor, factor: float) -> th.Tensor:
        """Noise with its opposite part times a factor."""
        image = _image(noise, self._action)
        return 0.5 * (noise + image) + 0.5 * factor * (noise - image)
