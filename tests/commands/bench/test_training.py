"""The speed of a whole training. How fast it is is no test; what is compared with what is."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch as th
from sb3_contrib import RecurrentPPO as StockRecurrentPPO
from stable_baselines3.common.vec_env import DummyVecEnv

from ogmp_sb3.commands.bench import training
from ogmp_sb3.config.load import load_task
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.hyperparameters import default_ppo
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

SMALL = replace(default_ppo(), n_steps=8, batch_size=16, n_epochs=1)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """No thousand environments."""
    monkeypatch.setattr(training, "_memory_per_env", lambda _: 0.0)


@pytest.mark.usefixtures("small")
def test_parts_add_up_to_the_whole_and_threads_are_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    train = RecurrentPPO.train

    def watched(model: RecurrentPPO) -> None:
        seen.append((th.get_num_threads(), model.rollout_buffer.full))
        train(model)

    monkeypatch.setattr(RecurrentPPO, "train", watched)
    monkeypatch.setattr(training, "seconds_of", lambda body: (body(), 1000.0)[1])
    before = th.get_num_threads()
    parts = training.Training(load_task("parkour"), 2, SMALL, threads=1).run(32)
    assert seen == [(1, True)] * 2 and th.get_num_threads() == before
    assert set(parts) == set(training.PARTS) and sum(parts.values()) == pytest.approx(1000.0)
    assert all(seconds > 0 for seconds in parts.values())
    assert parts["inference"] > parts["physics"] + parts["environment"] + parts["learner"]


@pytest.mark.usefixtures("small")
def test_training_and_bare_physics_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    task = load_task("parkour", {"physics_dt": 0.005})
    events: list[object] = []
    monkeypatch.setattr(training.Training, "run", lambda _, samples: events.append(samples) or dict.fromkeys(PARTS, 1))
    replay = training.bare_replay

    def watched(task: training.TaskConfig, *rest: object) -> object:
        events.append(task.physics_dt)
        return replay(task, *rest)

    PARTS = training.PARTS
    monkeypatch.setattr(training, "bare_replay", watched)
    monkeypatch.setattr(training, "seconds_of", lambda body: events.append(len(body())) or 2.0)
    numbers = training.bench_train(task, num_envs=2, steps=40, repeats=2, recipe=SMALL, stock=False)
    # 2 ms whatever the task has; one rollout of 16 samples to warm up; 40 samples are two whole rollouts.
    assert events == [0.002, 16, 32, 8, 32, 8]
    assert numbers["samples_per_second"] == 32 / 4 and numbers["bare_physics_steps_per_second"] == 16 / 2
    assert numbers["training_over_bare_physics"] == 1.0
    assert [numbers[f"share_{part}"] for part in PARTS] == [0.25] * 4
    assert "train_over_stock" not in numbers


@pytest.mark.parametrize(("control_dt", "bare_dt"), [(0.03, 0.002), (0.025, 0.025 / 12), (0.001, 0.001)])
def test_bare_physics_steps_as_near_to_two_milliseconds_as_the_control_step_allows(
    control_dt: float, bare_dt: float
) -> None:
    steps = {"physics_dt": control_dt, "evaluation.physics_dt": None}
    task = load_task("parkour", {"control_dt": control_dt, **steps})
    assert training.at_bare_dt(task).physics_dt == pytest.approx(bare_dt)


def test_a_training_goes_on_from_a_policy_at_the_end_of_its_curriculum() -> None:
    loaded = load_policy("parkour")
    task = training.trained_task(loaded.task, loaded.policy)
    begun = training.Training(task, 2, replace(default_ppo(), gamma=0.9), loaded.policy, threads=1)
    assert begun.model.gamma == 0.9
    for name, weights in loaded.policy.state_dict().items():
        assert th.equal(begun.model.policy.state_dict()[name], weights), name
    assert begun.model.env.get_attr("level") == [1.0, 1.0]


@pytest.mark.usefixtures("small")
def test_stock_has_the_same_settings_weights_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "SubprocVecEnv", DummyVecEnv)
    learned = []

    def learn(model: StockRecurrentPPO, samples: int, **_: object) -> None:
        learned.append((samples, model.n_steps, model.n_epochs, model.batch_size, th.get_num_threads()))

    monkeypatch.setattr(StockRecurrentPPO, "learn", learn)
    before = th.get_num_threads()
    assert training._stock_rate(load_task("parkour"), 2, SMALL, None) > 0
    assert learned == [(16, 8, 1, 16, 1)] * 2 and th.get_num_threads() == before
