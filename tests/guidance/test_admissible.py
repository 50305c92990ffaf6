"""Between which values a bound makes sense."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance import admissible
from ogmp_sb3.guidance.admissible import (
    AdmissibleRho,
    Behaviour,
    admissible_rho,
    standing_deviation,
    standing_still,
)
from ogmp_sb3.guidance.modes import FLIP_RATE, Contact, Segment, Span
from ogmp_sb3.guidance.set_points import Reference
from ogmp_sb3.guidance.srb import GRAVITY

STEADY = {"modes": {"pace": {"v": 0.8, "length": 1.0}, "jump": None, "leap": None}, "curriculum": None}


def behaviour(task: TaskConfig, name: str) -> Behaviour:
    (found,) = (each for each in admissible_rho(task).behaviours if each.name == name)
    return found


# ---- what the words say ----


def interval(low: float, **behaviours: tuple[float, float]) -> AdmissibleRho:
    each = (Behaviour(name=name, least=a, greatest=b, weighed=a > 0.0) for name, (a, b) in behaviours.items())
    return AdmissibleRho(low=low, behaviours=tuple(each), queries=10, left_out=0)


@pytest.mark.parametrize(
    ("rho", "words"),
    [
        (None, "0.10 to 0.50; rho is off"),
        (0.05, "0.10 to 0.50; 0.05 is below: some references cannot be followed so closely"),
        (0.3, "0.10 to 0.50; 0.3 is inside"),
        (0.6, "0.10 to 0.50; 0.6 is above: it permits standing"),
        (0.8, "0.10 to 0.50; 0.8 is above: it permits standing, spinning"),
    ],
)
def test_a_bound_is_inside_the_interval_or_said_to_be_beyond_an_end(rho: float | None, words: str) -> None:
    assert interval(0.1, standing=(0.5, 0.9), spinning=(0.7, 0.8), idling=(0.0, 0.0)).judged(rho) == words


def test_an_interval_may_have_no_upper_end_or_be_empty() -> None:
    assert interval(0.1).judged(3.0) == "0.10 or more; 3 is inside"
    assert interval(0.1, idling=(0.0, 0.2)).high == math.inf
    words = "none: no feasible motion comes closer than 0.40 to some reference, but standing comes within 0.30"
    assert interval(0.4, standing=(0.3, 0.9)).judged(0.35) == words
    assert interval(math.inf).judged(0.5).startswith("unknown: no feasible motion")


@pytest.mark.parametrize(
    ("rho", "words"),
    [
        (0.5, "deviates by 0.54 to 1.62, leaves the bound"),
        (0.54, "deviates by 0.54 to 1.62, stays inside the bound in some modes"),
        (1.62, "deviates by 0.54 to 1.62, stays inside the bound"),
        (None, "deviates by 0.54 to 1.62, stays inside the bound"),
    ],
)
def test_a_behaviour_is_judged_in_the_modes_that_are_easiest_and_hardest_for_it(rho: float | None, words: str) -> None:
    assert Behaviour(name="standing still", least=0.54, greatest=1.62).judged(rho) == words
    unseen = Behaviour(name="x", least=0.0, greatest=0.3, weighed=False)
    assert unseen.judged(rho) == "the bound does not weigh what it changes"


# ---- standing still ----


def test_linear_walks_away_from_a_robot_that_stands_by_speed_times_horizon() -> None:
    assert standing_deviation(load_task("parkour", {**STEADY, "oracle": "linear"})) == pytest.approx((0.72, 0.72))
    halved = load_task("parkour", {**STEADY, "oracle": "linear", "bound.x": 0.5})
    assert standing_deviation(halved) == pytest.approx((0.36, 0.36))
    every_mode = load_task("parkour", {"oracle": "linear"})
    assert standing_deviation(every_mode) == pytest.approx((0.54, 1.62))  # pace from 0.6 to 1.8 m/s


@pytest.mark.parametrize(("v", "horizon"), [(0.8, 30), (1.2, 15)])
@pytest.mark.parametrize("oracle", ["linear", "lqr", "preview"])
def test_a_robot_that_stands_deviates_as_far_as_the_reference_of_the_environment_goes(
    oracle: str, v: float, horizon: int
) -> None:
    """lqr and preview begin with the robot's velocity, so they get less far than v * horizon * control_dt."""
    task = load_task("parkour", {**STEADY, "oracle": oracle, "modes.pace.v": v, "horizon": horizon, "encoder": None,
                                 "observations.mode_latent": None})  # fmt: skip
    env = BatchEnv(task, seed=3)
    start = env.sim.qpos[0, env.sim.base_qpos]
    env.reset()
    far = 0.0
    for _ in range(horizon):
        view = env.step(np.zeros((1, env.action_size)), np.array([], dtype=int)).view  # physics at rest
        far = max(far, view.reference[0, 3] - start)
    assert standing_deviation(task) == pytest.approx((far, far), abs=1e-3)
    product = v * horizon * task.control_dt
    assert far == pytest.approx(product) if oracle == "linear" else far < product - 0.02


def test_standing_is_no_question_where_the_modes_stand_or_the_bound_weighs_nothing_that_moves() -> None:
    at_rest = load_task("parkour", {**STEADY, "modes.pace.v": 0.0})
    assert standing_still(at_rest) is standing_deviation(at_rest) is None
    high = load_task("parkour", {"bound": {"x": 0.0, "z": 1.0}})
    assert standing_deviation(high) is None
    assert standing_still(high) == "the bound does not weigh what it changes"
    fast = load_task("parkour", {**STEADY, "oracle": "linear", "bound": {"x": 0.0, "vx": 0.5}})
    assert standing_deviation(fast) == pytest.approx((0.4, 0.4))


# ---- turning ----


@pytest.mark.parametrize("rate_weight", [0.025, 0.5])
def test_a_flip_that_is_not_turned_or_turned_the_other_way_deviates_by_its_rate(rate_weight: float) -> None:
    height, rates = 1.0, {"wx": rate_weight, "wy": rate_weight}
    task = load_task("dive", {"oracle": "linear", "modes.flip.h": height, "bound": {"z": 1.0, **rates}})
    for name, times in (("not turning", 1.0), ("turning the other way", 2.0)):
        found = behaviour(task, name)
        assert (found.least, found.greatest) == pytest.approx((times * rate_weight * FLIP_RATE,) * 2, rel=1e-3)
    unseen = behaviour(load_task("dive", {"bound": {"z": 1.0, "wx": 0.0, "wy": 0.0}}), "not turning")
    assert not unseen.weighed


def test_angles_are_those_between_two_orientations() -> None:
    task = load_task(
        "dive", {"modes.flip.h": 1.0, "bound": {"z": 0.0, "wx": 0.0, "wy": 0.0, "pitch": 1.0, "roll": 1.0}}
    )
    found = behaviour(task, "not turning")  # a whole turn is never further than half a turn
    assert math.pi - 0.3 < found.least <= found.greatest <= math.pi


# ---- both ends ----


@pytest.mark.parametrize("oracle", ["linear", "lqr", "preview"])
def test_the_best_measured_bound_on_flat_ground_is_inside(oracle: str) -> None:
    """With 0.4 to 0.6 the robot runs, with 0.8 it stands (benchmarks/RESULTS.md, Bound)."""
    found = admissible_rho(load_task("parkour", {**STEADY, "oracle": oracle}))
    assert found.low < 0.05 and 0.6 < found.high < 0.8
    assert found.left_out == 0


def test_the_lower_end_is_the_error_of_linear_in_the_fall_from_the_highest_block() -> None:
    low, high = (
        admissible_rho(load_task("dive", {"oracle": "linear", "modes.flip.h": h, "bound": {"z": 1.0}})).low
        for h in (1.0, [1.0, 1.75])
    )
    # At the end it is where it should be, but falls a quarter as fast as a body that has fallen so far.
    assert 0.1 < low < 0.15 < 0.25 < high < 0.35
    assert admissible_rho(load_task("dive", {"bound": {"z": 1.0}})).low < 1e-6


def test_references_that_are_too_long_are_judged_by_their_beginning() -> None:
    assert admissible_rho(load_task("parkour", {**STEADY, "horizon": 400})).low < 1e-3


@pytest.mark.parametrize("horizon", [1, 2])
def test_a_horizon_may_be_as_short_as_one_step(horizon: int) -> None:
    found = admissible_rho(load_task("parkour", {**STEADY, "horizon": horizon}))
    assert found.low < found.high < 0.1


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mode that turns along a track, and an oracle that knows no dynamics and is nowhere near what is asked."""

    def barrel(v: float, rate: float) -> Segment:
        span = Span(end=1.0, velocity=(v, 0.0), contact=Contact.STANCE, rates=((0.0, 0.0), (rate, 0.0)))
        return Segment(length=1.0, spans=(span,))

    def offset(set_points: Any, x0: Any, plant: Any, by: float, where: float = 0.0) -> Reference:
        state = set_points.state.copy()
        state[..., 5] += by
        return Reference(state + where, set_points.steps)

    for kind, function in ((registry.modes, barrel), (registry.oracles, offset)):
        monkeypatch.setattr(kind, "_functions", dict(kind._functions))
        kind.register()(function)


def plugged(**parameters: float) -> TaskConfig:
    modes = {"barrel": {"v": 1.0, "rate": [1.0, 2.0]}, "pace": None, "jump": None, "leap": None}
    bound = {"x": 0.0, "z": 1.0, "wx": 0.1}
    params = {"oracle": "offset", "oracle_params.offset": parameters}
    return load_task("parkour", {"modes": modes, "curriculum": None, "bound": bound, **params})


def test_modes_and_oracles_of_plug_ins_are_asked_like_ours(plugins: None) -> None:
    task = plugged(by=0.7)
    found = admissible_rho(task)
    # 1.25 m is asked for at once. The body jumps off no faster than gravity stops where the legs are straight.
    half, rise = 0.5 * task.control_dt, 0.675 - 0.5
    speed = GRAVITY * (math.sqrt(half**2 + 2.0 * rise / GRAVITY) - half)
    assert found.low == pytest.approx(1.25 - (0.5 + half * speed), abs=2e-3)
    names = {each.name: each for each in found.behaviours}
    # The rate rises over the whole metre, of which the horizon sees 0.9 m.
    assert names["turning the other way"].least == pytest.approx(2 * 0.1 * 0.9, rel=1e-3)
    assert names["not turning"].greatest == pytest.approx(0.1 * 1.8, rel=1e-3)
    assert found.judged(task.rho).startswith("none: ")


def test_an_oracle_that_leads_nowhere_is_not_followed(plugins: None) -> None:
    found = admissible_rho(plugged(by=0.0, where=1e6))
    assert found.queries == 2 + admissible.TRACKS
