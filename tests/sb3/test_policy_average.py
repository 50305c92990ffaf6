"""The average of a policy's weights: what it is, that it is the policy that is kept, and that a run goes on with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch as th
from safetensors.torch import load_file

from helpers.programs import SMALL, program
from ogmp_sb3 import make_env
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.sb3.policy_average import PolicyAverage
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

ROLLOUT = 2 * 8


class Recorder(RecurrentPPO):
    """Keeps the weights after every update."""

    def train(self) -> None:
        super().train()
        self.updated = [*getattr(self, "updated", []), self.policy.state_dict()["action_net.weight"].clone()]


def trained(over: int, rollouts: int) -> tuple[PolicyAverage, list[th.Tensor]]:
    env = make_env("dive", num_envs=2, seed=0)
    model = Recorder(
        "MlpLstmPolicy", env, n_steps=8, batch_size=16, n_epochs=1, learning_rate=1e-2, seed=0, device="cpu",
        policy_kwargs={"net_arch": [], "lstm_hidden_size": 8},
    )  # fmt: skip
    average = PolicyAverage(over)
    model.learn(rollouts * ROLLOUT, callback=average)
    return average, model.updated


def test_over_a_long_time_it_is_the_mean_of_the_weights_of_all_updates() -> None:
    average, weights = trained(over=10**9, rollouts=5)
    assert not th.equal(weights[0], weights[-1])
    th.testing.assert_close(average.weights["action_net.weight"], th.stack(weights).mean(dim=0))


@pytest.mark.parametrize("over", [1, 10**9])
def test_after_one_update_it_is_what_that_made(over: int) -> None:
    average, (weights,) = trained(over, rollouts=1)
    th.testing.assert_close(average.weights["action_net.weight"], weights)


def test_it_forgets_as_fast_as_its_time_constant_says() -> None:
    average, weights = trained(over=2 * ROLLOUT, rollouts=8)
    keep = math.exp(-0.5)
    expected = weights[0]
    for n, w in enumerate(weights[1:], start=2):
        share = max(1 - keep, 1 / n)
        expected = (1 - share) * expected + share * w
    th.testing.assert_close(average.weights["action_net.weight"], expected)


@pytest.mark.parametrize("over", ["null", "300"])
def test_the_policy_that_is_kept_is_the_average_and_the_training_goes_on_from_the_last_weights(
    over: str, tmp_path: Path
) -> None:
    arguments = ["task=dive", *SMALL, "total_timesteps=640", f"policy_average={over}", "hydra.run.dir=run"]
    assert program("train", *arguments, cwd=tmp_path).returncode == 0
    checkpoint = checkpoint_dirs(tmp_path / "run")[-1]
    kept, trainer = load_file(checkpoint / "policy.safetensors"), load_file(checkpoint / "trainer.safetensors")
    last = {name.removeprefix("policy."): tensor for name, tensor in trainer.items() if name.startswith("policy.")}
    loaded = load_policy(checkpoint).policy.state_dict()
    assert all(th.equal(loaded[name], tensor) for name, tensor in kept.items())
    if over == "null":
        assert not last
    else:
        assert last.keys() == kept.keys()
        difference = (last["action_net.weight"] - kept["action_net.weight"]).abs().max()
        assert 0 < difference < np.inf
