"""Updates that end in numbers which are none leave no trace but a count, and a training that makes only such stops."""

from __future__ import annotations

import copy
import itertools
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.logger import Logger
from torch import nn

from ogmp_sb3.sb3.finite_updates import MOST_IN_A_ROW, check_weights, undone_unless_finite
from ogmp_sb3.sb3.policy import Normaliser, policy_kwargs
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO
from ogmp_sb3.sb3.vec_env import make_env

STEPS, ENVS = 16, 4


def learner() -> SimpleNamespace:
    policy = nn.Linear(3, 2)
    policy.log_std = nn.Parameter(th.zeros(2))
    policy.optimizer = th.optim.Adam(policy.parameters(), lr=0.1)
    return SimpleNamespace(policy=policy, num_timesteps=7, undone_updates=0, undone_in_a_row=0)


def update(model: SimpleNamespace, spoil: float | None = None) -> None:
    model.policy(th.ones(1, 3)).sum().backward()
    model.policy.optimizer.step()
    if spoil is not None:
        with th.no_grad():
            model.policy.weight[0, 0] = spoil


def test_an_update_that_ends_in_numbers_stays() -> None:
    model = learner()
    before = model.policy.weight.clone()
    with undone_unless_finite(model):
        update(model)
    assert not th.equal(before, model.policy.weight)
    assert model.undone_updates == 0


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_update_that_does_not_is_undone_with_its_optimiser_and_said(value: float) -> None:
    model = learner()
    update(model)
    before = copy.deepcopy((model.policy.state_dict(), model.policy.optimizer.state_dict()))
    with (
        pytest.warns(UserWarning, match="Update at step 7 undone: the weights 'weight' are not finite"),
        undone_unless_finite(model),
    ):
        update(model, value)
    weights, optimiser = model.policy.state_dict(), model.policy.optimizer.state_dict()
    assert all(th.equal(weights[name], before[0][name]) for name in weights)
    assert all(
        th.equal(optimiser["state"][i][name], entry[name])
        for i, entry in before[1]["state"].items()
        for name in ("step", "exp_avg", "exp_avg_sq")
    )
    assert (model.undone_updates, model.undone_in_a_row) == (1, 1)


def test_many_undone_updates_in_a_row_end_the_training_but_not_as_many_in_all() -> None:
    model = learner()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(2):
            for _ in range(MOST_IN_A_ROW - 1):
                with undone_unless_finite(model):
                    update(model, float("nan"))
            with undone_unless_finite(model):
                update(model)
        with pytest.raises(ValueError, match=f"step 7: {MOST_IN_A_ROW} updates in a row were undone"):
            for _ in range(MOST_IN_A_ROW):
                with undone_unless_finite(model):
                    update(model, float("nan"))
    assert model.undone_updates == 3 * MOST_IN_A_ROW - 2
    assert th.isfinite(model.policy.weight).all()


@pytest.mark.parametrize("log_std", [200.0, -200.0])
def test_a_standard_deviation_must_be_finite_and_above_zero(log_std: float) -> None:
    model = learner()
    check_weights(model.policy)
    with th.no_grad():
        model.policy.log_std[0] = log_std
    with pytest.raises(FloatingPointError, match="standard deviation of the actions is not finite and above 0"):
        check_weights(model.policy)


# ---- in the learner ----


@pytest.fixture(scope="module")
def env():
    return make_env("parkour", ENVS, seed=1, rho=0.15)


def trained(env) -> RecurrentPPO:
    """A learner of our own network after one update, before the second."""
    kwargs = policy_kwargs(env.batch.observation_scale, lstm_hidden_size=8, n_lstm_layers=1)
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=STEPS, batch_size=32, n_epochs=2, policy_kwargs=kwargs, seed=0)
    _, callback = model._setup_learn(10**6)
    model.set_logger(Logger(None, []))
    model.collect_rollouts(env, callback, model.rollout_buffer, STEPS)
    model.train()
    model.collect_rollouts(env, callback, model.rollout_buffer, STEPS)
    return model


FAULTS = {
    "reward": "a reward of the rollout is not finite",
    "returns": "a loss or a gradient is not finite",
    "huge returns": r"a loss or a gradient is not finite \(policy loss .*, value loss inf",
    "observation": "the network's output is not finite",
    "learning rate": "the network's output is not finite",
    "std": "a loss or a gradient is not finite",
    "std of the last step": "the standard deviation of the actions is not finite and above 0",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_of_an_update_gives_the_last_good_weights_back(fault: str, env) -> None:
    model = trained(env)
    before = copy.deepcopy(model.policy.state_dict())
    buffer, optimiser = model.rollout_buffer, model.policy.optimizer
    if fault == "reward":
        buffer.rewards[3, 1] = np.nan
    elif fault == "returns":
        buffer.returns[3, 1] = np.nan
    elif fault == "huge returns":  # the square overflows, its gradient does not
        buffer.returns[3, 1] = 1e25
    elif fault == "observation":
        buffer.observations[3, 1, 0] = np.nan
    elif fault == "learning rate":
        model.lr_schedule = lambda _: float("inf")
    else:
        step, left = optimiser.step, itertools.count(1 if fault == "std" else 1 - STEPS * ENVS // 32 * model.n_epochs)

        def spoilt_step() -> None:
            step()
            if next(left) >= 0:
                model.policy.log_std.data.fill_(100.0)

        optimiser.step = spoilt_step
    with pytest.warns(UserWarning, match=f"Update at step {2 * STEPS * ENVS} undone: .*({FAULTS[fault]})"):
        model.train()
    after = model.policy.state_dict()
    assert [name for name in before if not th.equal(before[name], after[name])] == []
    assert model.logger.name_to_value["train/undone_updates"] == 1


def test_stock_training_is_guarded_too() -> None:
    """Networks that train as in sb3-contrib: here, a critic behind the actor's LSTM."""
    env = make_env("parkour", ENVS, seed=1, rho=0.15)
    network = {
        "lstm_hidden_size": 8,
        "enable_critic_lstm": False,
        "shared_lstm": True,
        "features_extractor_class": Normaliser,
    }
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=STEPS, batch_size=32, n_epochs=1, policy_kwargs=network)
    assert not model._fast
    _, callback = model._setup_learn(10**6)
    model.set_logger(Logger(None, []))
    model.collect_rollouts(env, callback, model.rollout_buffer, STEPS)
    before = copy.deepcopy(model.policy.state_dict())
    model.rollout_buffer.returns[0, 0] = np.nan
    with pytest.warns(UserWarning, match="undone: the weights .* are not finite"):
        model.train()
    after = model.policy.state_dict()
    assert all(th.equal(before[name], after[name]) for name in before)
