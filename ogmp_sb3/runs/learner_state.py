"""Save and restore a learner between updates, as tensors and plain data; its weights apart."""

from __future__ import annotations

import random
from collections import deque
from typing import Any

import numpy as np
import torch as th
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from ogmp_sb3.config.messages import Where, describe
from ogmp_sb3.config.strict import read
from ogmp_sb3.runs.storage import check_shapes
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import OgmpVecEnv

MOMENTS = ("exp_avg", "exp_avg_sq")  # of Adam
# What numbers that are not those of a learner can end in, in NumPy, PyTorch and our own environments.
MISFITS = (TypeError, ValueError, RuntimeError, AttributeError, IndexError, OverflowError)


def state(model: RecurrentPPO) -> tuple[dict[str, th.Tensor], dict[str, Any]]:
    """The optimiser, the generators, the simulations and the counts of a learner between two updates.

    :param model: the learner, on an :class:`~ogmp_sb3.sb3.vec_env.OgmpVecEnv`
    """
    env = model.env
    assert isinstance(env, OgmpVecEnv)
    arrays, plain = env.state()
    optimiser = model.policy.optimizer.state_dict()["state"]
    tensors = {f"env.{name}": th.as_tensor(array) for name, array in arrays.items()}
    tensors |= {f"lstm.{i}": tensor for i, tensor in enumerate(_lstm_states(model))}
    tensors |= {f"optimiser.{i}.{name}": th.as_tensor(v) for i, entry in optimiser.items() for name, v in entry.items()}
    tensors["torch_generator"] = th.get_rng_state()
    tensors["last_observation"] = th.as_tensor(model._last_obs)
    tensors["last_episode_starts"] = th.as_tensor(model._last_episode_starts)
    algorithm, keys, *rest = np.random.get_state()
    return tensors, {
        "num_timesteps": model.num_timesteps,
        "updates": model._n_updates,
        "undone_updates": model.undone_updates,
        "episodes": list(model.ep_info_buffer or []),
        "environment": plain,
        "python_generator": random.getstate(),
        "numpy_generator": [algorithm, np.asarray(keys).tolist(), *rest],
    }


def set_state(model: RecurrentPPO, tensors: dict[str, th.Tensor], plain: dict[str, Any]) -> None:
    """Go on exactly where :func:`state` was taken; the tensors become the learner's own.

    :param model: a learner with the same network, task and number of environments
    :raises ValueError: if the state is of another one
    """
    try:
        _set_state(model, tensors, plain)
    except KeyError as error:
        raise ValueError(f"'{error.args[0]}' is missing") from None
    except MISFITS as error:
        raise ValueError(" ".join(str(error.args[0] if error.args else error).split())) from None


def _set_state(model: RecurrentPPO, tensors: dict[str, th.Tensor], plain: dict[str, Any]) -> None:
    env, where = model.env, Where("trainer.json")
    assert isinstance(env, OgmpVecEnv)
    expected = {
        "last_observation": (env.num_envs, env.batch.observation_size),
        "last_episode_starts": (env.num_envs,),
        **{f"lstm.{i}": tuple(tensor.shape) for i, tensor in enumerate(_lstm_states(model))},
    }
    optimiser = model.policy.optimizer.state_dict()
    optimised = {i: p for i, p in enumerate(model.policy.parameters()) if f"optimiser.{i}.step" in tensors}
    expected |= {f"optimiser.{i}.{name}": tuple(p.shape) for i, p in optimised.items() for name in MOMENTS}
    check_shapes(expected, tensors)
    optimiser["state"] = {i: {n: tensors[f"optimiser.{i}.{n}"] for n in ("step", *MOMENTS)} for i in optimised}
    model.policy.optimizer.load_state_dict(optimiser)

    arrays = {k.removeprefix("env."): t.numpy() for k, t in tensors.items() if k.startswith("env.")}
    env.set_state(arrays, plain["environment"])
    model.num_timesteps = read(int, plain["num_timesteps"], where / "num_timesteps")
    model._n_updates = read(int, plain["updates"], where / "updates")
    model.undone_updates = read(int, plain.get("undone_updates", 0), where / "undone_updates")
    for i, episode in enumerate(read(tuple[Any, ...], plain["episodes"], where / "episodes")):
        check_numbers(episode, where / "episodes" / i)
    model.ep_info_buffer = deque(plain["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    model._last_obs = tensors["last_observation"].numpy()
    model._last_episode_starts = tensors["last_episode_starts"].numpy()
    lstm = [tensors[f"lstm.{i}"].to(model.device) for i in range(4)]
    model._last_lstm_states = RNNStates((lstm[0], lstm[1]), (lstm[2], lstm[3]))
    version, internal, gauss = plain["python_generator"]
    random.setstate((version, tuple(internal), gauss))
    np.random.set_state(plain["numpy_generator"])
    th.set_rng_state(tensors["torch_generator"])


def check_numbers(data: Any, where: Where) -> None:
    """:raises TypeError: unless data is a mapping of names to numbers, which need not be finite."""
    for name, value in read(dict[str, Any], data, where).items():
        if not isinstance(value, int | float):
            raise TypeError(f"{where / name} must be a number, found {describe(value)}.")


def _lstm_states(model: RecurrentPPO) -> list[th.Tensor]:
    states = model._last_lstm_states
    assert states is not None
    return [*states.pi, *states.vf]
