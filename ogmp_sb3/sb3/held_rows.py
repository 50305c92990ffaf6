"""Step some environments of a batch while others stay exactly as they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from ogmp_sb3.env.batch_env import BatchEnv, StepResult

OF_EACH = "restarts"  # of a batch's plain data: lists of which each has an entry for every environment


def step_others(batch: BatchEnv, actions: np.ndarray, held: np.ndarray) -> StepResult:
    """Advance all environments but some by one control step.

    :param actions: shape (num_envs, joints), clipped to [-1, 1]
    :param held: which stay as they are, generators and all, shape (num_envs,), bool
    :return: the results, which mean nothing for those
    :raises ValueError: for actions of another shape
    """
    if not held.any():
        return batch.step(actions)
    arrays, plain = batch.state()
    result = batch.step(actions, np.flatnonzero(~held))
    moved, drawn = batch.state()
    kept = {name: np.where(_along(held, values), arrays[name], values) for name, values in moved.items()}
    batch.set_state(kept, {name: _chosen(name, plain[name], value, held) for name, value in drawn.items()})
    return result


def _along(held: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A mask of environments in the shape that goes with their values."""
    return held.reshape(-1, *[1] * (values.ndim - 1))


def _chosen(name: str, before: Any, after: Any, held: np.ndarray) -> Any:
    """The plain data of those that stayed and of those that went on."""
    if name == OF_EACH:
        return [_chosen("", *pair, held) for pair in zip(before, after, strict=True)]
    return [old if stays else new for old, new, stays in zip(before, after, held, strict=True)]
