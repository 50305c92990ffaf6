"""What more cores would bring, predicted from trainings with one and with two threads: ``ogmp-bench scaling``."""

from __future__ import annotations

from ogmp_sb3.commands.bench.timing import Numbers, median
from ogmp_sb3.commands.bench.training import PARTS, Training, shares, trained_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.runs.settings import thread_count
from ogmp_sb3.sb3.hyperparameters import PPOConfig
from ogmp_sb3.sb3.policy import LstmPolicy

CORES = (4, 8, 16, 32)
THREADED = ("physics", "inference", "learner")  # the environment around its physics has one thread
NETWORKS = ("inference", "learner")  # parts whose two threads are actor and critic


def bench_scaling(
    task: TaskConfig, num_envs: int, repeats: int, recipe: PPOConfig, policy: LstmPolicy | None = None
) -> Numbers:
    """Rates and shares of trainings with one and two threads, in turns, and what they let expect of more cores.

    :param recipe: hyper-parameters
    :param policy: whose training goes on; None: an untrained one
    :raises ValueError: if this process may use one CPU only
    """
    if thread_count("auto") < 2:
        raise ValueError("'scaling' compares one thread with two, but this process may use one CPU only.")
    task = trained_task(task, policy)
    trainings = {threads: Training(task, num_envs, recipe, policy, threads) for threads in (1, 2)}
    parts: dict[int, list[Numbers]] = {threads: [] for threads in trainings}
    for training in trainings.values():
        training.run(training.rollout)  # what is made once, is
    for _ in range(repeats):
        for threads, training in trainings.items():
            parts[threads].append(training.run(training.rollout))
    rollout = trainings[1].rollout
    one, two = ({part: median([run[part] for run in parts[threads]]) / rollout for part in PARTS} for threads in (1, 2))
    numbers: Numbers = {}
    for threads, sample in ((1, one), (2, two)):
        numbers[f"samples_per_second_{threads}_threads"] = 1 / sum(sample.values())
        numbers |= {f"{name}_{threads}_threads": share for name, share in shares(parts[threads]).items()}
    numbers |= {f"parallel_{part}": parallel_share(one[part], two[part]) for part in THREADED}
    for cores in CORES:
        numbers[f"predicted_samples_per_second_{cores}_cores"] = predicted(one, two, cores)
    for cores in CORES:
        numbers[f"predicted_samples_per_second_{cores}_cores_at_most"] = predicted(one, two, cores, networks=True)
    return numbers


def parallel_share(one: float, two: float) -> float:
    """The share p of some work that several threads do together, by Amdahl's law t(n) = t(1) (1 - p + p / n).

    :param one: time with one thread
    :param two: with two
    :return: from 0 to 1, also where the measurements lie beyond
    """
    return min(max(2 * (1 - two / one), 0.0), 1.0) if one > 0 else 0.0


def predicted(one: Numbers, two: Numbers, cores: int, networks: bool = False) -> float:
    """Samples/s with more cores, by Amdahl's law for each part of a training.

    :param one: seconds of each part for one sample, with one thread
    :param two: with two
    :param cores: with as many threads as cores, at least 2
    :param networks: whether inference and learner gain from more than two threads; else they are as with two, one for
        the actor and one for the critic
    """
    seconds = sum(one[part] for part in PARTS if part not in THREADED)
    for part in THREADED:
        share, threads = parallel_share(one[part], two[part]), 2 if part in NETWORKS and not networks else cores
        seconds += one[part] * (1 - share + share / threads)
    return 1 / seconds
