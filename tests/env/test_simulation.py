"""Batched MuJoCo: the terrain really moves, trouble stays in its row, threads change nothing."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ogmp_sb3.config.load import load_robot
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.simulation import Simulation
from ogmp_sb3.guidance.terrain import empty_terrain

HECTOR = load_robot("hector")
PHYSICS_DT = 0.002  # s
BOXES = 3
FAR = 1.0e4  # m
SUBSTEPS = 15


def ground(*boxes: tuple[float, ...]) -> np.ndarray:
    """One row of terrain: the given boxes, the rest unused."""
    terrain = empty_terrain(1, BOXES)
    terrain[0, : len(boxes)] = boxes
    return terrain[0]


def simulation(num_envs: int, threads: int = 1) -> Simulation:
    """Robots over a flat box with its top at z = 0."""
    sim = Simulation(HECTOR, num_envs, PHYSICS_DT, BOXES, threads)
    rows = np.arange(num_envs)
    sim.set_terrain(rows, np.tile(ground((-2, 2, -1, 1, 0.0)), (num_envs, 1, 1)))
    sim.place(rows, np.tile([0.0, 0.0, 0.5], (num_envs, 1)), np.zeros(10))
    return sim


@pytest.fixture(scope="module")
def sim() -> Simulation:
    """Three robots; every test places them itself."""
    return simulation(3)


def put(sim: Simulation, positions: list[list[float]]) -> None:
    sim.place(np.arange(len(sim.qpos)), np.array(positions, dtype=float), np.zeros(10))


def lowest_point(sim: Simulation, row: int) -> float:
    """Height of the lowest point of any colliding geom of the robot, by MuJoCo's own boxes around geoms, m."""
    model, data = sim.mj.get_model(row), sim.mj.get_data(row)
    mujoco.mj_forward(model, data)
    lowest = np.inf
    for i in range(model.ngeom):
        if model.geom_bodyid[i] and model.geom_group[i] == 3:
            centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
            rotation = data.geom_xmat[i].reshape(3, 3)
            lowest = min(lowest, data.geom_xpos[i, 2] + rotation[2] @ centre - np.abs(rotation[2]) @ half)
    return lowest


# ---- the model ----


def test_a_diverged_simulation_is_not_restarted_behind_our_back() -> None:
    model = build_model(HECTOR, PHYSICS_DT, 1)
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_a_base_without_a_free_joint_is_an_error() -> None:
    with pytest.raises(ValueError, match="free joint"):
        Simulation(replace(HECTOR, base="L_hip"), 1, PHYSICS_DT, 1, 1)


# ---- terrain ----


def test_the_gains_are_those_of_the_servos(sim: Simulation) -> None:
    np.testing.assert_array_equal(sim.servos.kp, 30.0)
    np.testing.assert_array_equal(sim.servos.kd, 0.5)


def test_a_robot_rests_on_a_box_that_was_moved_and_raised_and_not_where_it_was(sim: Simulation) -> None:
    raised = ground((4, 8, -1, 1, 0.7))
    sim.set_terrain(np.arange(3), np.stack([raised, raised, ground((-2, 2, -1, 1, 0.0))]))
    put(sim, [[6, 0, 0.7 + 0.5], [0, 0, 0.5], [6, 0, 0.7 + 0.5]])
    sim.step(None, 1000)
    assert lowest_point(sim, 0) == pytest.approx(0.7, abs=0.02)
    assert np.abs(sim.qvel[0, :3]).max() < 0.5
    fallen = 9.81 * 2.0**2 / 2
    assert sim.qpos[1, 2] == pytest.approx(0.5 - fallen, abs=0.5)  # the old place is empty
    assert sim.qpos[2, 2] == pytest.approx(1.2 - fallen, abs=0.5)  # boxes are the row's own


@pytest.mark.parametrize("x0, x1", [(FAR - 0.5, FAR + 0.5), (-2.0, FAR + 3.0)], ids=["short", "long"])
def test_boxes_carry_a_robot_ten_kilometres_away_as_they_do_at_home(sim: Simulation, x0: float, x1: float) -> None:
    home, away = (ground((a, b, -1, 1, 0.25)) for a, b in ((-0.5, 0.5), (x0, x1)))
    sim.set_terrain(np.arange(3), np.stack([home, away, home]))
    put(sim, [[0, 0, 0.75], [FAR, 0, 0.75], [FAR, 0, 0.75]])
    sim.step(None, 100)
    assert lowest_point(sim, 1) == pytest.approx(0.25, abs=0.03)
    np.testing.assert_allclose(sim.qpos[1] - np.eye(17)[0] * FAR, sim.qpos[0], atol=1e-6)
    assert sim.qpos[2, 2] < 0.75 - 0.9 * 9.81 * 0.2**2 / 2
    assert not sim.unstable().any()


def test_a_step_up_stops_a_foot_at_its_edge(sim: Simulation) -> None:
    """Beside a box there is no invisible wall, and a box is as wide as it says."""
    block = ground((-2, 2, -1, 1, 0.0), (0.3, 1.0, -0.2, 0.2, 0.4))
    sim.set_terrain(np.arange(3), np.tile(block, (3, 1, 1)))
    put(sim, [[0.2, 0, 0.5], [0.2, 0.6, 0.5], [0.2, 0, 1.5]])
    sim.qvel[:, 0] = 2.0
    sim.step(None, 50)
    assert sim.qvel[0, 0] < 1.6  # runs into the block
    assert sim.qpos[1, 0] > sim.qpos[0, 0] + 0.02  # passes beside it
    assert sim.qpos[2, 0] == pytest.approx(0.2 + 2.0 * 0.1, abs=0.01)  # flies above it


def test_moving_the_terrain_of_some_rows_leaves_the_others(sim: Simulation) -> None:
    sim.set_terrain(np.arange(3), np.tile(ground((-2, 2, -1, 1, 0.0)), (3, 1, 1)))
    sim.set_terrain(np.array([2, 0]), np.stack([ground((0, 1, -1, 1, 0.2)), ground((0, 1, -1, 1, 0.1))]))
    tops = []
    for row in range(3):
        geom = sim.mj.get_model(row).geom("terrain_0")
        tops.append(geom.pos[2] + geom.size[2])
    np.testing.assert_allclose(tops, [0.1, 0.0, 0.2], atol=1e-12)


# ---- placing ----


def test_placing_puts_robots_down_at_rest_and_forgets_everything(sim: Simulation) -> None:
    sim.set_terrain(np.arange(3), np.tile(ground((-2, 2, -1, 1, 0.0)), (3, 1, 1)))
    put(sim, [[0, 0, 0.5]] * 3)
    sim.ctrl[:] = 1.0
    sim.step(None, 100)
    kept = sim.qpos[1].copy(), sim.qvel[1].copy(), sim.ctrl[1].copy()
    joints = np.linspace(-0.2, 0.2, 10)
    sim.place(np.array([0, 2]), np.array([[0.0, 0.1, 0.2], [2.0, 2.1, 2.2]]), joints)
    for row, position in ((0, [0.0, 0.1, 0.2]), (2, [2.0, 2.1, 2.2])):
        np.testing.assert_array_equal(sim.qpos[row], [*position, 1, 0, 0, 0, *joints])
        np.testing.assert_array_equal(sim.qvel[row], 0.0)
        np.testing.assert_array_equal(sim.ctrl[row], joints)
    for now, before in zip((sim.qpos[1], sim.qvel[1], sim.ctrl[1]), kept, strict=True):
        np.testing.assert_array_equal(now, before)


def test_a_placed_robot_moves_as_a_new_one(sim: Simulation) -> None:
    """Nothing of the past survives: no warm start, no time, no contact."""
    sim.set_terrain(np.arange(3), np.tile(ground((-2, 2, -1, 1, 0.0)), (3, 1, 1)))
    put(sim, [[0, 0, 0.5]] * 3)
    sim.ctrl[0] = 1.0
    sim.step(np.array([0]), 300)
    sim.place(np.array([0]), np.array([[0.0, 0.0, 0.5]]), np.zeros(10))
    assert not sim.body_contact()[0]
    sim.step(None, 200)
    np.testing.assert_array_equal(sim.qpos[0], sim.qpos[1])
    np.testing.assert_array_equal(sim.qvel[0], sim.qvel[1])


def test_only_the_rows_asked_for_are_stepped(sim: Simulation) -> None:
    put(sim, [[0, 0, 1.0]] * 3)
    sim.step(np.array([1]), 10)
    np.testing.assert_array_equal(sim.qvel[[0, 2]], 0.0)
    assert sim.qvel[1, 2] == pytest.approx(-9.81 * 10 * PHYSICS_DT, rel=1e-3)


# ---- what is read ----


def test_body_contact_is_felt_by_trunk_and_legs_but_not_by_feet_nor_in_the_air(sim: Simulation) -> None:
    sim.set_terrain(np.arange(3), np.tile(ground((-2, 2, -1, 1, 0.0)), (3, 1, 1)))
    put(sim, [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 3.0]])
    sim.qpos[1, 3:7] = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]  # on its side
    sim.qpos[1, 2] = 0.12
    sim.step(None, 30)
    model, data = sim.mj.get_model(0), sim.mj.get_data(0)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0  # row 0 stands on its feet
    np.testing.assert_array_equal(sim.body_contact(), [False, True, False])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e12, 1e6])
def test_a_velocity_that_is_not_sane_makes_its_row_unstable_and_only_it(sim: Simulation, value: float) -> None:
    put(sim, [[0, 0, 0.5]] * 3)
    sim.qvel[1, 7] = value
    sim.step(None, SUBSTEPS)
    np.testing.assert_array_equal(sim.unstable(), [False, True, False])
    np.testing.assert_array_equal(sim.qpos[0], sim.qpos[2])
    assert np.isfinite(sim.qpos[0]).all()
    sim.step(None, SUBSTEPS)
    np.testing.assert_array_equal(sim.unstable(), [False, True, False])


@pytest.mark.parametrize("value", [np.nan, 1e12])
def test_an_absurd_position_or_control_makes_its_row_unstable_and_placing_heals_it(
    sim: Simulation, value: float
) -> None:
    put(sim, [[0, 0, 0.5]] * 3)
    sim.qpos[0, 1] = value
    sim.ctrl[1, 3] = value
    sim.step(None, SUBSTEPS)
    np.testing.assert_array_equal(sim.unstable(), [True, True, False])
    sim.place(np.array([0]), np.array([[0.0, 0.0, 0.5]]), np.zeros(10))
    np.testing.assert_array_equal(sim.unstable(), [False, True, False])
    put(sim, [[0, 0, 0.5]] * 3)
    sim.step(None, SUBSTEPS)
    assert not sim.unstable().any()
    np.testing.assert_array_equal(sim.qpos[0], sim.qpos[2])


def test_threads_change_nothing_bit_for_bit() -> None:
    states = []
    for threads in (1, 2, 3):
        sim = simulation(7, threads)
        rng = np.random.default_rng(0)
        for _ in range(20):
            sim.ctrl[:] = rng.uniform(-1, 1, sim.ctrl.shape)
            sim.step(None, SUBSTEPS)
        states.append(np.concatenate([sim.qpos, sim.qvel], axis=1))
    assert not np.array_equal(states[0][0], states[0][1])
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0], states[2])


# ---- robots of one's own ----


def masses(sim: Simulation, *factors: float) -> dict[str, np.ndarray]:
    """Mass and inertia of all bodies times a factor for each row."""
    fields = {name: getattr(sim.model, name) for name in ("body_mass", "body_inertia")}
    return {name: np.stack([factor * values for factor in factors]) for name, values in fields.items()}


def test_a_heavier_robot_is_the_one_that_mujoco_makes_of_heavier_bodies() -> None:
    sim = simulation(3)
    sim.vary(np.array([0, 2]), masses(sim, 0.5, 1.3))
    for row, factor in enumerate((0.5, 1.0, 1.3)):
        model = build_model(HECTOR, PHYSICS_DT, BOXES)
        model.body_mass *= factor
        model.body_inertia *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
        varied = sim.mj.get_model(row)
        for field in ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0"):
            np.testing.assert_allclose(getattr(varied, field), getattr(model, field), rtol=1e-12, err_msg=field)


def test_the_ground_carries_the_weight_of_a_heavier_robot() -> None:
    sim = simulation(2)
    sim.vary(np.arange(2), masses(sim, 1.0, 1.5))
    put(sim, [[0, 0, 0.5]] * 2)
    sim.step(None, 1500)
    for row, factor in enumerate((1.0, 1.5)):
        model, data = sim.mj.get_model(row), sim.mj.get_data(row)
        mujoco.mj_forward(model, data)
        assert data.qfrc_constraint[2] == pytest.approx(factor * 14.046 * 9.81, rel=0.05)


def test_friction_is_that_of_every_contact_of_its_row() -> None:
    sim = simulation(2)
    friction = sim.model.geom_friction.copy()
    friction[:, 0] = 0.35
    sim.vary(np.array([1]), {"geom_friction": friction[None]})
    put(sim, [[0, 0, 0.5]] * 2)
    sim.step(None, 50)
    for row, friction in enumerate((1.0, 0.35)):
        model, data = sim.mj.get_model(row), sim.mj.get_data(row)
        mujoco.mj_forward(model, data)
        assert data.ncon > 0
        np.testing.assert_allclose([contact.friction[:2] for contact in data.contact], friction)


def test_torques_are_those_of_the_servos_with_their_gains() -> None:
    sim = simulation(3)
    sim.vary(np.array([0, 2]), {"gains": np.repeat([[0.5], [1.4]], 10, axis=1)})
    put(sim, [[0, 0, 3.0]] * 3)
    rng = np.random.default_rng(0)
    sim.ctrl[:] = rng.uniform(-0.3, 0.3, sim.ctrl.shape)
    sim.qvel[:, 6:] = rng.uniform(-1, 1, (3, 10))
    torque = sim.torque(np.arange(3), sim.qpos[:, sim.joint_qpos], sim.qvel[:, sim.joint_qvel])
    for row, factor in enumerate((0.5, 1.0, 1.4)):
        model, data = sim.mj.get_model(row), sim.mj.get_data(row)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(torque[row], data.actuator_force, rtol=1e-9)
        np.testing.assert_allclose(torque[row] / factor, 30.0 * (sim.ctrl[row] - 0.0) - 0.5 * sim.qvel[row, 6:])


def test_a_push_changes_the_horizontal_velocity_of_its_rows_alone() -> None:
    sim = simulation(3)
    sim.qvel[:] = 1.0
    sim.push(np.array([0, 2]), np.array([[0.5, -0.5], [2.0, 0.0]]))
    expected = np.ones_like(sim.qvel)
    expected[0, :2], expected[2, :2] = (1.5, 0.5), (3.0, 1.0)
    np.testing.assert_array_equal(sim.qvel, expected)


# ---- contacts ----


def test_a_robot_that_lies_still_is_carried_by_the_forces_of_its_contacts() -> None:
    sim = simulation(2)
    sim.place(np.arange(2), np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 3.0]]), np.zeros(10))
    sim.step(None, 150)
    assert sim.contacts(1)[0].shape == (0, 3)  # it still falls
    sim.step(None, 3000)
    points, forces = sim.contacts(0)
    weight = float(sim.model.body_mass.sum()) * 9.81
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, weight], atol=0.1 * weight)
    assert (forces[:, 2] >= 0.0).all() and (np.abs(points[:, 2]) < 0.05).all()
