"""Values that are allowed but extreme do what docs/task-file.md says, and those beyond are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.programs import program
from ogmp_sb3 import load_task
from ogmp_sb3.env.batch_env import BatchEnv, StepResult
from ogmp_sb3.guidance.terrain import NOTHING, height_at
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.sb3.vec_env import OgmpVecEnv, make_env

STEPS = 12


def play(overrides: dict[str, Any], num_envs: int = 2, steps: int = STEPS) -> tuple[BatchEnv, list[StepResult]]:
    """Some steps of random actions, with resets; everything must stay finite."""
    env = BatchEnv(load_task("parkour", {"curriculum": None, **overrides}), num_envs, seed=1, threads=1)
    env.reset()
    rng, results = np.random.default_rng(0), []
    for _ in range(steps):
        result = env.step(rng.uniform(-0.3, 0.3, (num_envs, env.action_size)))
        assert np.isfinite(result.observation).all()
        assert np.isfinite(result.reward).all()
        results.append(result)
        ended = np.flatnonzero(result.termination != "")
        if len(ended):
            env.reset(ended)
    return env, results


def ground(env: BatchEnv, x: list[float]) -> np.ndarray:
    """Heights along the centre line of the first environment, m."""
    return height_at(env.terrain[:1], np.stack([x, np.zeros(len(x))], axis=1)[None])[0]


def only(mode: str, **parameters: float) -> dict[str, Any]:
    """A task of one mode."""
    ranges = {"pace": {"v": 0.8}, "jump": {"w": 0.4, "h": 0.2}, "leap": {"w": 0.3, "d": 0.5}}[mode]
    return {"modes": {"pace": None, "jump": None, "leap": None, mode: {**ranges, **parameters}}}


def asked_every_step(env: BatchEnv, results: list[StepResult]) -> None:
    assert (env.guide.plans.period == 1).all()
    assert all((result.view.phase == 1).all() for result in results)


def one_step_each(env: BatchEnv, results: list[StepResult]) -> None:
    assert all((result.termination == "time_limit").all() and result.truncated.all() for result in results)


def ends_by_the_bound(env: BatchEnv, results: list[StepResult]) -> None:
    assert all((result.termination == "bound").all() and result.terminated.all() for result in results)


def explodes_or_runs(env: BatchEnv, results: list[StepResult]) -> None:
    for result in results:
        assert (result.reward[result.termination == "unstable"] == 0).all()


def flat(env: BatchEnv, results: list[StepResult]) -> None:
    assert (ground(env, np.linspace(-0.5, 1.2, 50).tolist()) == 0).all()


def wall(env: BatchEnv, results: list[StepResult]) -> None:
    assert ground(env, [0.3, 0.6]).tolist() == [0.0, 2.0]


def stays(env: BatchEnv, results: list[StepResult]) -> None:
    reference = env.plan(0)
    assert np.ptp(reference[1:, 3]) < 0.2


def beside(env: BatchEnv, results: list[StepResult]) -> None:
    under = height_at(env.terrain, np.array([[[0.1, 0.0], [0.1, 0.01]]] * 2))
    assert (under[:, 0] == 0).all() and (under[:, 1] == NOTHING).all()


def blind(env: BatchEnv, results: list[StepResult]) -> None:
    assert (env.plan(0)[0] == 0).all()


def limited(env: BatchEnv, results: list[StepResult]) -> None:
    assert np.abs(env.sim.qvel).max() < 1e3


ALLOWED: list[tuple[str, dict[str, Any], Callable[[BatchEnv, list[StepResult]], None]]] = [
    ("horizon: 1", {"horizon": 1, "rho": None}, asked_every_step),
    ("episode_steps: 1", {"episode_steps": 1, "rho": None, "terminations": {"fall": None}}, one_step_each),
    ("rho: 1e-9", {"rho": 1e-9, "bound": {"z": 1.0}}, ends_by_the_bound),
    ("physics_dt equal to control_dt", {"physics_dt": 0.03}, explodes_or_runs),
    ("leap: {w: 0}", only("leap", w=0.0), flat),
    ("jump: {h: 0}", only("jump", h=0.0), flat),
    ("jump: {h: 2}", only("jump", h=2.0), wall),
    ("pace: {v: 0}", only("pace", v=0.0), stays),
    ("track: {width: 0.001}", {"track.width": 0.001, "evaluation.initial": None}, beside),
    ("track: {length: 0.001}", {"track.length": 0.001, **only("pace")}, flat),
    ("feedback: []", {"feedback": [], "rho": None}, blind),
    ("action: {scale: 1e6}", {"action.scale": 1e6, "rho": None}, limited),
]


@pytest.mark.parametrize(("overrides", "holds"), [entry[1:] for entry in ALLOWED], ids=[entry[0] for entry in ALLOWED])
def test_what_is_allowed_but_extreme_does_what_the_documentation_says(
    overrides: dict[str, Any], holds: Callable[[BatchEnv, list[StepResult]], None]
) -> None:
    holds(*play(overrides))


def test_every_extreme_of_the_documentation_is_tested_and_the_other_way_round() -> None:
    text = (ROOT / "docs" / "task-file.md").read_text(encoding="utf-8")
    section = text.partition("## Extreme values")[2].partition("\n## ")[0]
    rows = [line.split("|")[1].replace("`", "").strip() for line in section.splitlines() if line.startswith("| ")][1:]
    documented = [value for row in rows for value in row.split(", ")]
    assert documented == [*(entry[0] for entry in ALLOWED), "num_envs=10000"]


def test_ten_thousand_environments_step() -> None:
    env = OgmpVecEnv(load_task("parkour"), num_envs=10_000, threads=1)
    observation, reward, done, infos = env.step(np.zeros((10_000, 10), dtype=np.float32))
    assert observation.shape == (10_000, env.observation_space.shape[0])
    assert np.isfinite(observation).all() and np.isfinite(reward).all()
    assert len(infos) == len(done) == 10_000


def test_minibatches_of_one_sample_leave_the_policy_finite(tmp_path: Path) -> None:
    sizes = ["num_envs=2", "ppo.n_steps=1", "ppo.batch_size=1", "ppo.lstm_hidden_size=8", "total_timesteps=8"]
    done = program("train", "task=dive", *sizes, "hydra.run.dir=run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(weights.isfinite().all() for weights in load_policy(tmp_path / "run").policy.parameters())


REFUSED = [
    ({"num_envs": 0}, "'num_envs' must be at least 1 and at most 100,000, found 0."),
    ({"num_envs": 10**9}, "'num_envs' must be at least 1 and at most 100,000, found 1000000000."),
    ({"seed": -1}, "'seed' must be at least 0, found -1."),
    ({"rho": 0}, "'rho' must be above 0, or null for no bound, found 0."),
    ({"horizon": 10**6}, "'horizon' must be at most 10000 control steps, found 1000000."),
    ({"control_dt": 0.001}, "control_dt / physics_dt must be a whole number below 10000, found 0.001 / 0.002 = 0.5."),
    ({"control_dt": 1e300}, "'control_dt' is too large: numbers lie between -1e+12 and 1e+12, found 1e+300."),
    ({"track.boxes": 10**6}, "'track': boxes must be at most 1000, found 1000000."),
    ({"track.boxes": 2}, "'track.boxes' is 2, too few for the terrain around a robot"),
    (only("pace", length=1e-6), "'modes' are too short: over 1000 set-point spans around a robot."),
    ({"modes.pace.length": 0}, "'modes.pace' takes no length of the track (v 0.6, length 0."),
    ({"modes.pace.v": 1e9}, "speeds in 'modes' times 'horizon', or 'observations.height_scan', reach 9e+08 m ahead"),
    ({"observations.height_scan.points": 10**9}, "'observations.height_scan', reach 4e+07 m ahead"),
    ({"observations.height_scan": {"points": 1001, "spacing": 0.001}}, "needs 1 to 1000 of 'points', found 1001."),
]


@pytest.mark.parametrize(("overrides", "sentence"), REFUSED)
def test_what_is_beyond_is_refused_in_one_sentence(overrides: dict[str, Any], sentence: str) -> None:
    kwargs = {name: overrides[name] for name in ("num_envs", "seed") if name in overrides}
    rest = {name: value for name, value in overrides.items() if name not in kwargs}
    with pytest.raises(ValueError) as caught:
        make_env(load_task("parkour", {"curriculum": None, **rest}), **{"num_envs": 1, **kwargs})
    assert sentence in caught.value.args[0]
    assert "\n" not in caught.value.args[0]


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        ("eval", ["run=parkour", "episodes=0"], "'episodes' must be at least 1, found 0."),
        ("eval", ["run=parkour", "max_distance=nan"], "'max_distance' must be a number, found the text 'nan'."),
        ("eval", ["run=parkour", "max_distance=.nan"], "'max_distance' must be finite, found nan."),
        ("eval", ["run=parkour", "seed=-1"], "'seed' must be at least 0, found -1."),
        ("eval", ["run=parkour", "grid=jump.w:nan:1:3,jump.h"], "needs 0 <= low < high and 1 to 100 cells."),
        ("eval", ["run=parkour", "grid=jump.w:0.1:1:1000000000,jump.h"], "and 1 to 100 cells."),
        ("play", ["task=dive", "seconds=1e13"], "'seconds' is too large"),
        ("train", ["task=dive", "seed=-1"], "'seed' must be at least 0, found -1."),
        (
            "train",
            ["task=dive", "physics_threads=1000000"],
            "'physics_threads' must be auto or a whole number from 1 to",
        ),
        ("train", ["task=dive", "num_envs=1", "ppo.n_steps=1"], "one sample is too few to learn from."),
        ("train", ["task=dive", "ppo.clip_range=0"], "'clip_range' must be above 0, found 0."),
        ("train", ["task=dive", "ppo.lstm_hidden_size=1000000"], "'lstm_hidden_size' must be at most 4,096"),
        ("check", ["dive", "out=/proc/nowhere"], "'/proc/nowhere': nothing can be saved there ("),
    ],
)
def test_an_extreme_of_a_program_is_refused_in_one_sentence(
    name: str, arguments: list[str], sentence: str, tmp_path: Path
) -> None:
    done = program(name, *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
