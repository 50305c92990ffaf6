"""BatchEnv on tracks: they go on for ever or end as declared, and their modes fill their ranges."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.batches import ON_TRACK, OPEN, SEED, at_full_level, base_x, inside, put_upright
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.robot import STATE_NAMES
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.guidance.terrain import BOX_DEPTH, NOTHING, X0, X1, Y0, Y1


def check_track(env: BatchEnv) -> None:
    """Ground ahead and behind, no hole or overlap, within the pool, and MuJoCo has the same boxes."""
    for row, x in enumerate(base_x(env)):
        used = env.terrain[row][env.terrain[row, :, 4] > NOTHING]
        assert len(used) <= env.task.track.boxes
        assert used[0, X0] <= max(x - 0.8, -2.0)
        assert used[-1, X1] >= x + 1.2
        np.testing.assert_allclose(used[1:, X0], used[:-1, X1], atol=1e-9)
        assert (used[:, X1] > used[:, X0]).all()
        half_width = 0.5 * env.task.track.width
        np.testing.assert_array_equal(used[:, [Y0, Y1]], [[-half_width, half_width]] * len(used))
        model = env.sim.mj.get_model(row)
        for box, (x0, x1, y0, y1, top) in enumerate(env.terrain[row]):
            geom = model.geom(f"terrain_{box}")
            if top > NOTHING:
                np.testing.assert_allclose(geom.pos - geom.size, [x0, y0, top - BOX_DEPTH], atol=1e-9)
                np.testing.assert_allclose(geom.pos + geom.size, [x1, y1, top], atol=1e-9)
                assert geom.rbound[0] >= np.linalg.norm(geom.size) - 1e-9
            else:
                assert geom.pos[2] + geom.size[2] < -10.0


@pytest.mark.parametrize("name", ON_TRACK)
def test_the_track_goes_on_for_hundreds_of_metres_and_ten_kilometres_away(name: str) -> None:
    env = BatchEnv(at_full_level(load_task(name, OPEN)), 2, SEED, threads=1)
    env.reset()
    check_track(env)
    heights: set[float] = set()
    for step in range(700):
        put_upright(env, base_x(env) + np.array([0.3, 0.28]))
        result = env.step(np.zeros((2, 10)))
        assert (result.termination == "").all()
        assert (result.view.ground_height > -10.0).all()
        heights |= set(result.view.ground_height.round(6).tolist())
        if step % 25 == 0:
            check_track(env)
    assert base_x(env).min() > 190.0
    assert len(heights) > 50  # not one flat box
    put_upright(env, np.array([1.0e4, 250.0]))
    env.step(np.zeros((2, 10)))
    check_track(env)
    put_upright(env, base_x(env) + 0.01)
    view = env.step(np.zeros((2, 10))).view
    check_track(env)
    assert np.isfinite(view.reference).all()
    assert view.ground_height[0] > -10.0
    assert abs(view.base_pos_w[0, 0] - 1.0e4) < 0.1


@pytest.mark.parametrize("name", ON_TRACK)
def test_the_reference_far_away_is_that_of_home(name: str) -> None:
    """On flat ground, 12 km away; 12 060 m and 60 m both hold a whole number of hops, so hops are equally long."""
    flat = {
        "modes.pace.v": 0.8,
        "modes.pace.length": 1.2e4 + 60.0,
        "sampling": {"order": "sequence", "sequence": ["pace"], "repeat": "all"},
    }
    task = at_full_level(load_task(name, {**OPEN, **flat, "sampling.weights": {}}))
    env = BatchEnv(task, 2, SEED, threads=1)
    env.reset()
    offset = np.where(np.array(STATE_NAMES) == "x", 1.2e4, 0.0)
    no_physics = np.array([], dtype=int)
    for _ in range(2 * task.horizon):  # up to the first query from there, and over its whole horizon
        put_upright(env, np.array([0.0, 1.2e4]))
        view = env.step(np.zeros((2, 10)), no_physics).view
    np.testing.assert_array_equal(view.phase, task.horizon)
    np.testing.assert_allclose(view.reference[1] - offset, view.reference[0], atol=1e-6)
    assert view.reference[0, STATE_NAMES.index("x")] > 0.4


@pytest.mark.parametrize("name", ON_TRACK)
def test_modes_and_parameters_stay_in_their_ranges_and_fill_them(name: str) -> None:
    task = at_full_level(load_task(name, OPEN))
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    put_upright(env, np.array([400.0]))
    env.step(np.zeros((1, 10)))
    drawn: dict[tuple[str, str], list[float]] = {}
    for call in env.modes[0]:
        assert inside(task.mode_ranges[call.name], call.parameters)
        assert set(call.parameters) == set(task.mode_ranges[call.name])
        for key, value in call.parameters.items():
            drawn.setdefault((call.name, key), []).append(float(value))
    assert {mode for mode, _ in drawn} == set(task.mode_ranges)
    for (mode, key), values in drawn.items():
        range_ = task.mode_ranges[mode][key]
        assert max(values) - min(values) >= 0.9 * (range_.high - range_.low)


def test_a_dive_draws_its_direction_and_height_and_then_settles() -> None:
    task = load_task("dive", {"rho": None, "min_step_reward": None})
    env = BatchEnv(task, 24, SEED, threads=1)
    env.reset()
    ranges = task.mode_ranges["flip"]
    starts = env.view().base_pos_w[:, 2]
    for start, (flip, *others) in zip(starts, env.modes, strict=True):
        assert flip.name == "flip"
        assert not others
        assert ranges["h"].low <= float(flip.parameters["h"]) <= ranges["h"].high
        assert start == pytest.approx(float(flip.parameters["h"]) + 0.5)
    assert {modes[0].parameters["r"] for modes in env.modes} == set(ranges["r"].words)
    for _ in range(90):
        env.step(np.zeros((24, 10)), np.array([], dtype=int))
    for modes in env.modes:
        assert len(modes) >= 2
        assert {call.name for call in modes[1:]} == {"settle"}


@pytest.mark.parametrize("name", ON_TRACK)
def test_behind_the_end_of_a_finite_track_the_ground_is_flat_for_ever(name: str) -> None:
    task = at_full_level(load_task(name, {**OPEN, "track.length": 5.0}))
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    longest = max(call.segment().length for call in env.modes[0]) + 1.0
    seen = []
    for _ in range(200):
        put_upright(env, base_x(env) + 0.1)
        view = env.step(np.zeros((1, 10))).view
        seen.append((base_x(env)[0], view.ground_height[0]))
    x, height = np.array(seen).T
    assert (height[x > 5.0 + longest] == 0.0).all()
    assert (height[x < 5.0] != 0.0).any()
    assert x.max() > 15.0


@pytest.mark.parametrize("name", ON_TRACK)
def test_a_long_height_scan_never_sees_the_end_of_the_laid_track(name: str) -> None:
    """However far the scan looks, the track is laid at least as far."""
    scan = {"points": 61, "spacing": 0.04}  # 2.4 m
    task = replace(at_full_level(load_task(name, OPEN)), observations={"height_scan": scan})
    env = BatchEnv(task, 1, SEED, threads=1)
    env.reset()
    for _ in range(40):
        put_upright(env, base_x(env) + 0.05)
        heights = env.step(np.zeros((1, 10))).observation
        assert heights.min() > -1.0  # of the pit where there is no ground


def test_a_pool_too_small_for_the_track_is_an_error_that_names_the_key() -> None:
    with pytest.raises(ValueError, match=r"parkour\.yaml: 'track\.boxes' is 3, too few"):
        small = BatchEnv(at_full_level(load_task("parkour", {**OPEN, "track.boxes": 3})), 1, SEED, threads=1)
        for _ in range(50):
            put_upright(small, base_x(small) + 0.3)
            small.step(np.zeros((1, 10)))
