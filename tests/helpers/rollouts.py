"""A rollout full of short episodes, ours and stock's."""

from __future__ import annotations

from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.logger import Logger

from ogmp_sb3 import make_env
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

SETTINGS = {"n_steps": 24, "batch_size": 48, "n_epochs": 2, "seed": 3, "device": "cpu"}
NETWORK = {"net_arch": [], "lstm_hidden_size": 16, "n_lstm_layers": 2}


def rollout(env, **settings) -> RecurrentPPO:
    """A learner with a full rollout and random weights, just before its update."""
    model = RecurrentPPO("MlpLstmPolicy", env, **{"policy_kwargs": NETWORK, **SETTINGS, **settings})
    _, callback = model._setup_learn(10**6)
    model.set_logger(Logger(None, []))
    model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
    assert model.rollout_buffer.episode_starts.sum() > 8, "the rollout must hold many episode starts"
    return model


def stock_twin(model: RecurrentPPO, env, **network) -> StockRecurrentPPO:
    """Stock with the same weights and the same rollout.

    :param network: of the model, beside :data:`NETWORK`
    """
    stock = StockRecurrentPPO("MlpLstmPolicy", env, policy_kwargs={**NETWORK, **network}, **SETTINGS)
    stock.policy.load_state_dict(model.policy.state_dict())
    stock.set_logger(Logger(None, []))
    source, target = model.rollout_buffer, stock.rollout_buffer
    for name in (
        "observations",
        "actions",
        "rewards",
        "returns",
        "episode_starts",
        "values",
        "log_probs",
        "advantages",
    ):
        getattr(target, name)[...] = getattr(source, name)
    for step, states in enumerate(source.states):
        for name, state in zip(
            ("hidden_states_pi", "cell_states_pi", "hidden_states_vf", "cell_states_vf"),
            (*states.pi, *states.vf),
            strict=True,
        ):
            getattr(target, name)[step] = state.numpy()
    target.full, target.pos = True, target.buffer_size
    return stock


def short_episodes(**changes):
    """Environments whose episodes last nine steps at most."""
    return make_env("parkour", num_envs=4, seed=1, episode_steps=9, curriculum=None, **changes)
