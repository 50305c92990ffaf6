"""Film a training: the policy on a test track, at intervals, without the training noticing."""

from __future__ import annotations

import random
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.callbacks import BaseCallback

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.video import Format, write_video
from ogmp_sb3.runs.atomic import reason
from ogmp_sb3.sb3.policy_average import PolicyAverage
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

FOLDER = "videos"  # in a run directory
SECONDS = 5.0  # of a film
SMALL = Format(480, 272, 2)
"""A picture takes a tenth of a second where OpenGL is in software, for which the training waits."""
SEED = 0  # of its track, the same for all films, so that they can be compared


class Films(BaseCallback):
    """Films the policy between two updates, whenever the samples pass a multiple of ``every``.

    It plays an environment and a policy of its own, and puts the global random generators back, so that a training is
    the same bit for bit with it and without. A film that fails is warned of once, and the training goes on. A film that
    is there already, of samples that are run again, stays.

    :param folder: where films go, ``<samples>.mp4``
    :param task: what is trained; it is played by its test protocol
    :param every: samples between two films
    :param average: whose weights are those of the policy that is kept; None: the last ones are
    """

    def __init__(self, folder: Path, task: TaskConfig, every: int, average: PolicyAverage | None = None) -> None:
        super().__init__()
        self.folder, self.task, self.every, self.average = folder, task, every, average
        self._warned = False

    def _on_rollout_start(self) -> None:
        self._film_if_due()

    def _on_training_end(self) -> None:
        self._film_if_due()

    def _on_step(self) -> bool:
        return True

    def _film_if_due(self) -> None:
        model = self.model
        assert isinstance(model, RecurrentPPO)
        samples, rollout = model.num_timesteps, model.n_steps * model.n_envs
        file = self.folder / f"{samples:012d}.mp4"
        if not samples or samples // self.every == (samples - rollout) // self.every or file.exists():
            return
        try:
            with _generators_kept():
                film(self._policy(model), self.task, file)
        except Exception as error:  # whatever it is, a training does not end by its film
            if not self._warned:
                text = reason(error) if isinstance(error, OSError) else " ".join(str(error).split())
                warnings.warn(
                    f"{file}: not filmed ({text.rstrip('.') or type(error).__name__}); the training goes on.",
                    stacklevel=2,
                )
            self._warned = True

    def _policy(self, model: RecurrentPPO) -> Any:
        """A copy of the policy that a checkpoint would keep now."""
        policy = model.policy_class(
            model.observation_space, model.action_space, model.lr_schedule, use_sde=model.use_sde, **model.policy_kwargs
        )
        policy.load_state_dict(self.average.weights if self.average else model.policy.state_dict())
        return policy


def film(policy: Any, task: TaskConfig, file: Path) -> None:
    """Write a short video of a policy on a test track; new episodes begin until it is over.

    :param policy: of Stable-Baselines3
    :param task: as in training
    :param file: ``.mp4``; it is there as a whole, or not
    :raises ValueError: if nothing can be drawn
    :raises OSError: if it cannot be written
    """
    player = Player(task, policy, SEED)
    frames = [player.frame, *(player.step() for _ in range(round(SECONDS / task.control_dt)))]
    unfinished = file.with_name(f".unfinished{file.suffix}")
    try:
        write_video(frames, task, unfinished, kind=SMALL)
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def _generators_kept() -> Iterator[None]:
    """Put the global random generators back as they were, whatever the body draws from them."""
    python, numpy = random.getstate(), np.random.get_state()
    try:
        with th.random.fork_rng():
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)
