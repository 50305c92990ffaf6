"""Policies with random weights, and what is exported of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.learners import make_policy
from ogmp_sb3.commands.export import bundle
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy


@pytest.fixture(scope="session")
def policies(tmp_path_factory) -> dict[str, Path]:
    """By name: of both tasks, one with layers in front of its LSTM, and one that does not see the latent."""
    folder = tmp_path_factory.mktemp("policies")
    return {
        "parkour": make_policy(folder / "parkour", "parkour", 2),
        "dive": make_policy(folder / "dive", "dive", 1, input_layers=(24, 16)),
        "blind": make_policy(folder / "blind", "parkour", 3, "observations.mode_latent=null", "action.scale=0.5"),
    }


@pytest.fixture(scope="session")
def exported(policies, tmp_path_factory) -> Callable[[str], tuple[LoadedPolicy, BatchEnv, Path]]:
    """Gives a policy, an environment of its task, and the directory that it is exported to."""
    folder = tmp_path_factory.mktemp("exported")

    def get(name: str) -> tuple[LoadedPolicy, BatchEnv, Path]:
        loaded = load_policy(policies[name])
        env = BatchEnv(loaded.task.for_evaluation(), threads=1)
        if not (folder / name).exists():
            bundle.export(loaded, env, folder / name)
        return loaded, env, folder / name

    return get
