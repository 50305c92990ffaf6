"""What more cores would bring."""

from __future__ import annotations

import pytest

from ogmp_sb3.commands.bench import scaling
from ogmp_sb3.config.load import load_task
from ogmp_sb3.sb3.hyperparameters import default_ppo

# Seconds of one sample with one thread and with two: physics shares its work out wholly, the environment not at all,
# inference half of it, and the learner two thirds.
ONE = {"physics": 8.0, "environment": 1.0, "inference": 2.0, "learner": 6.0}
TWO = {"physics": 4.0, "environment": 1.0, "inference": 1.5, "learner": 4.0}


@pytest.mark.parametrize(("part", "share"), [("physics", 1.0), ("inference", 0.5), ("learner", 2 / 3)])
def test_shares_by_amdahl_s_law(part: str, share: float) -> None:
    assert scaling.parallel_share(ONE[part], TWO[part]) == pytest.approx(share)


def test_measurements_beyond_the_law_are_at_its_ends() -> None:
    assert scaling.parallel_share(1.0, 0.4) == 1.0
    assert scaling.parallel_share(1.0, 1.1) == 0.0
    assert scaling.parallel_share(0.0, 0.0) == 0.0


def test_two_cores_are_as_measured() -> None:
    assert scaling.predicted(ONE, TWO, 2) == pytest.approx(1 / 10.5)
    assert scaling.predicted(ONE, TWO, 2, networks=True) == pytest.approx(1 / 10.5)


def test_networks_gain_nothing_from_more_than_two_threads_unless_asked() -> None:
    assert scaling.predicted(ONE, TWO, 8) == pytest.approx(1 / (1 + 1 + 1.5 + 4))
    # physics 8 / 8, environment 1, inference 1 + 1 / 8, learner 2 + 4 / 8
    assert scaling.predicted(ONE, TWO, 8, networks=True) == pytest.approx(1 / (1 + 1 + 1.125 + 2.5))


def test_an_environment_that_was_faster_beside_two_threads_by_chance_is_serial_all_the_same() -> None:
    assert scaling.predicted(ONE, {**TWO, "environment": 0.5}, 8) == scaling.predicted(ONE, TWO, 8)


def test_one_cpu_is_too_few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "thread_count", lambda _: 1)
    with pytest.raises(ValueError, match="compares one thread with two, but this process may use one CPU only"):
        scaling.bench_scaling(load_task("parkour"), num_envs=2, repeats=1, recipe=default_ppo())


def test_trainings_with_one_and_two_threads_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []

    class Training:
        rollout = 10

        def __init__(self, task: object, num_envs: int, recipe: object, policy: object, threads: int) -> None:
            self.threads = threads

        def run(self, samples: int) -> dict[str, float]:
            runs.append(self.threads)
            return {part: 10 * seconds for part, seconds in (ONE if self.threads == 1 else TWO).items()}

    monkeypatch.setattr(scaling, "thread_count", lambda _: 2)
    monkeypatch.setattr(scaling, "Training", Training)
    numbers = scaling.bench_scaling(load_task("parkour"), num_envs=2, repeats=3, recipe=default_ppo())
    assert runs == [1, 2] * 4  # the first of each warms up
    assert numbers["samples_per_second_1_threads"] == pytest.approx(1 / 17)
    assert numbers["samples_per_second_2_threads"] == pytest.approx(1 / 10.5)
    assert numbers["share_physics_1_threads"] == pytest.approx(8 / 17)
    assert numbers["predicted_samples_per_second_8_cores"] == pytest.approx(1 / 7.5)
    assert numbers["predicted_samples_per_second_8_cores_at_most"] == pytest.approx(1 / 5.625)
