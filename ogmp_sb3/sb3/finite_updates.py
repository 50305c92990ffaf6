"""Undo an update that produced NaN or infinity, and stop a training in which nothing else happens."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import torch as th

MOST_IN_A_ROW = 10  # updates that may be undone one after another
NOT_FINITE = "to satisfy the constraint"  # what PyTorch says of a distribution whose parameter is not finite


class Learner(Protocol):
    """A learner whose updates may be undone."""

    policy: Any
    """the network, with its ``optimizer``"""
    num_timesteps: int
    """samples so far"""
    undone_updates: int
    """how many were undone"""
    undone_in_a_row: int
    """how many of them since the last one that was not"""


@contextmanager
def undone_unless_finite(model: Learner) -> Iterator[None]:
    """Put weights and optimiser back as they were, with a warning, if the update inside produced NaN or infinity.

    :param model: the learner; the update inside may raise a FloatingPointError that says what was wrong
    :raises ValueError: if ``MOST_IN_A_ROW`` updates had to be undone one after another
    """
    policy, optimiser = copy.deepcopy((model.policy.state_dict(), model.policy.optimizer.state_dict()))
    try:
        yield
        check_weights(model.policy)
    except (FloatingPointError, ValueError) as error:
        reason = str(error)
        if isinstance(error, ValueError):
            if NOT_FINITE not in reason:
                raise
            reason = "the network's output is not finite."
        model.policy.load_state_dict(policy)
        model.policy.optimizer.load_state_dict(optimiser)
        model.undone_updates += 1
        model.undone_in_a_row += 1
        if model.undone_in_a_row >= MOST_IN_A_ROW:
            raise ValueError(
                f"stopped at step {model.num_timesteps}: {MOST_IN_A_ROW} updates in a row were undone, "
                f"the last because {reason} The weights are as before them; look for rewards that are not finite, "
                "or train anew with a smaller learning rate."
            ) from None
        warnings.warn(f"Update at step {model.num_timesteps} undone: {reason}", stacklevel=4)
    else:
        model.undone_in_a_row = 0


def check_weights(policy: Any) -> None:
    """:raises FloatingPointError: if a weight or the standard deviation of the actions is not finite, or that is 0."""
    for name, weight in policy.state_dict().items():
        if not th.isfinite(weight).all():
            raise FloatingPointError(f"the weights '{name}' are not finite.")
    if hasattr(policy, "log_std"):
        std = th.exp(policy.log_std.detach())
        if not (th.isfinite(std) & (std > 0)).all():
            limits = f"{std.min():g} to {std.max():g}"
            raise FloatingPointError(f"the standard deviation of the actions is not finite and above 0 ({limits}).")
