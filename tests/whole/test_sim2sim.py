"""The example sim2sim: its oracle and observations are those of ogmp_sb3, and its robot that of MuJoCo."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from helpers.paths import ROOT
from ogmp_sb3.commands.export import bundle
from ogmp_sb3.config.load import load_robot, load_task
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.servos import read_servos
from ogmp_sb3.guidance.latent import reference_features, task_encoder
from ogmp_sb3.guidance.plans import make_oracle
from ogmp_sb3.guidance.rotations import quat_rotate
from ogmp_sb3.guidance.set_points import set_points
from ogmp_sb3.guidance.srb import STATE_MIRROR
from ogmp_sb3.guidance.terrain import height_at

EXAMPLE = ROOT / "examples" / "sim2sim"
MODULES = ("urdf", "preview", "prepare", "observe", "bullet", "run")
ENGINE_DT = 0.00025
IN_REACH = 0.15  # rad: joint angles that are far from every limit
HOPPING = {"stance": {"z": 11000.0, "x": 3.0}, "flight": {"z": 1.0, "vx": 10.0}}


@pytest.fixture(scope="module", autouse=True)
def _importable() -> Iterator[None]:
    sys.path.insert(0, str(EXAMPLE))
    yield
    sys.path.remove(str(EXAMPLE))
    for name in MODULES:
        sys.modules.pop(name, None)


def evaluated(**overrides: Any) -> TaskConfig:
    return load_task("parkour", overrides).for_evaluation()


def told(task: TaskConfig) -> dict[str, Any]:
    """What controller.json says of a task, but for network and servos."""
    return {
        "task": task.name,
        "oracle": task.oracle,
        "horizon": task.horizon,
        "control_dt": task.control_dt,
        "guidance": json.loads(json.dumps(bundle.guidance(task))),
    }


# ---------------------------------------------------------------------- oracle and observations


@pytest.mark.parametrize("Q", [None, HOPPING])
def test_the_oracle_in_numpy_is_that_of_ogmp_sb3(Q: dict[str, Any] | None) -> None:
    import prepare
    import preview

    task = evaluated()
    preview_params = task.oracle_params["preview"]
    task = replace(task, oracle_params={"preview": {**preview_params, "Q": Q or preview_params["Q"]}})
    ours, oracle = preview.Preview(told(task)), make_oracle(task)
    rng, contacts = np.random.default_rng(0), set()
    for track in prepare.tracks(task, 3, 0)["tracks"]:
        spans = np.array(track["spans"])
        for x in rng.uniform(0.0, 12.0, 12):
            state = np.array([0, 0, 0, x, *rng.normal(0.0, 0.1, 2), 0, 0, 0, *rng.normal(0.6, 0.4, 3)])
            state[5] += 0.5
            points = set_points(
                spans[None], np.array([False]), state[None], np.array([task.horizon]), task.control_dt, task.gait
            )
            knots, stance = ours.set_points(spans, state)
            np.testing.assert_allclose(knots, points.state[0], rtol=0, atol=1e-12)
            np.testing.assert_array_equal(stance, points.stance[0])
            expected = oracle(points, state[None]).state[0]
            np.testing.assert_allclose(ours.reference(spans, state), expected, rtol=0, atol=1e-8)
            contacts |= set(spans[:, preview.CONTACT].tolist())
    assert contacts == {0.0, 1.0, 2.0}


def test_features_are_those_of_the_encoder_and_of_the_mirror_image() -> None:
    import preview

    reference = np.random.default_rng(1).normal(0.0, 0.3, (31, 12))
    expected = reference_features(np.stack([reference, STATE_MIRROR * reference]))
    np.testing.assert_allclose(preview.latent_features(reference), expected[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(preview.latent_features(reference, mirrored=True), expected[1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("named", [{"fall": {"min_height": 0.3}}, {"fall": {"min_height": 0.2, "fill_gaps": False}}])
def test_tracks_are_those_of_the_environment(named: dict[str, Any]) -> None:
    import observe
    import prepare
    import preview

    task = evaluated(**{"evaluation.terminations": named})
    data = json.loads(json.dumps(prepare.tracks(task, 2, 5)))
    assert (data["steps"], data["track_length"]) == (400, 10.0)
    assert data["fall"] == {"fill_gaps": True, **named["fall"]}
    env = BatchEnv(task, 2, threads=1, stream="test")
    env.seed(5)
    env.reset()
    every = np.arange(2)
    for x in np.arange(0.0, 14.0, 0.07):
        env.guide.follow(every[:0], np.full(2, x), lambda rows: np.zeros((len(rows), 12)), env._rng, env.level)
        for row in env.guide.course.short_of_track(every, np.full(2, x)):
            env.guide.course.extend(row, x, env._rng[row], 0.0)
        speed = env.guide.course.commanded_speed(every, np.full(2, x), np.zeros(2, dtype=int))
        for row, track in enumerate(data["tracks"]):
            places = np.column_stack([x + np.arange(0.0, 1.0, 0.04), np.full(25, 0.3)])
            height = height_at(env.terrain[row : row + 1], places[None])[0]
            np.testing.assert_array_equal(observe.ground_height(np.array(track["boxes"]), places[:, 0], 0.3), height)
            assert preview.commanded_speed(np.array(track["spans"]), x) == speed[row]
    assert data["tracks"][0]["boxes"] != data["tracks"][1]["boxes"]


OF_A_ROBOT = {f"observations.{name}": {} for name in ("imu", "heading", "joints", "last_action", "commanded_speed")}
OF_A_ROBOT_PARTS = ("gravity_b", "heading", "joint_pos", "last_action", "commanded_speed")


def test_observations_are_those_of_the_environment_over_several_queries(tmp_path: Path) -> None:
    import observe
    import prepare

    from ogmp_sb3.commands.export.onnx_graphs import encoder_model

    pytest.importorskip("onnxruntime")
    no_end = {"evaluation.terminations.fall.min_height": -5.0}  # a robot that falls goes on
    task = evaluated(**{"observations.mode_latent.both_sides": True, **OF_A_ROBOT, **no_end})
    encoder = task_encoder(task)
    assert encoder is not None
    (tmp_path / "encoder.onnx").write_bytes(encoder_model(encoder).SerializeToString())
    env = BatchEnv(task, 1, threads=1, stream="test")
    env.seed(7)
    terms = {name: parameters for name, parameters in task.observations.items() if parameters is not None}
    info = told(task) | {"observation": {"terms": terms, "components": bundle.observation_components(env)}}
    names = [component["name"] for component in info["observation"]["components"]]
    assert {"mirrored_mode_latent", "height_scan", *OF_A_ROBOT_PARTS} < set(names)
    observer = observe.Observer(tmp_path, info)
    observer.begin(prepare.tracks(task, 1, 7)["tracks"][0])
    observation, rng, action = env.reset(), np.random.default_rng(0), np.zeros((1, env.action_size))
    for _ in range(70):
        view = env.view()
        state = observe.State(
            pos=view.base_pos_w[0],
            quat=view.base_quat[0],
            linvel=view.base_linvel_w[0],
            angvel=quat_rotate(view.base_quat, view.base_angvel_b)[0],
            joint_pos=view.joint_pos[0],
            joint_vel=view.joint_vel[0],
        )
        found = observer.observe(state, action[0])
        limit = bundle.CLIP * env.observation_scale
        np.testing.assert_allclose(np.clip(found, -limit, limit), observation[0], rtol=1e-5, atol=2e-5)
        action = rng.uniform(-0.1, 0.1, (1, env.action_size))
        observation = env.step(action).observation


def test_what_the_example_does_not_know_is_one_sentence(tmp_path: Path) -> None:
    import observe
    import prepare
    import preview

    with pytest.raises(ValueError, match="knows tests on a track, with the one termination 'fall'"):
        prepare.tracks(load_task("dive").for_evaluation(), 1, 0)
    info = told(evaluated())
    seen = {"terms": {}, "components": [{"name": "heigth_scan"}]}
    with pytest.raises(ValueError, match=r"observes 'heigth_scan', which this example does not know.*'height_scan'\?"):
        observe.Observer(tmp_path, info | {"observation": seen})
    with pytest.raises(ValueError, match="oracle preview on a track, not 'lqr'"):
        preview.Preview(info | {"oracle": "lqr"})
    with pytest.raises(ValueError, match="no 'guidance': export the policy again"):
        preview.Preview(info | {"guidance": None})
    info["guidance"]["feedback"] = ["z", "pitch"]
    with pytest.raises(ValueError, match=r"fed back angles \(pitch\)"):
        preview.Preview(info)


# ---------------------------------------------------------------------- the robot


@pytest.fixture(scope="module")
def hector() -> RobotConfig:
    return load_robot("hector")


@pytest.fixture(scope="module")
def model(hector: RobotConfig) -> mujoco.MjModel:
    return build_model(hector, ENGINE_DT, terrain_boxes=1)


@pytest.mark.parametrize(
    ("found", "written", "sentence"),
    [
        ('damping="0.1" frictionloss', 'armature="0.01" frictionloss', "joint 'L_hip_yaw' has an armature, which URDF"),
        ('axis="0 1 0" range="-1.4', 'stiffness="2" axis="0 1 0" range="-1.4', "joint 'L_ankle' has a spring"),
        (
            'type="box" size="0.075',
            'type="ellipsoid" size="0.075',
            "'L_toe_collision' of body 'L_toe' collides, and is",
        ),
    ],
)
def test_what_urdf_cannot_say_is_refused(found, written, sentence, hector: RobotConfig, tmp_path: Path) -> None:
    import prepare

    mjcf = hector.mjcf_path.read_text(encoding="utf-8")
    assert found in mjcf
    (tmp_path / "model.xml").write_text(mjcf.replace(found, written), encoding="utf-8")
    with pytest.raises(ValueError, match=sentence):
        prepare.robot_files(replace(hector, mjcf=str(tmp_path / "model.xml")))


def test_links_meet_what_they_meet_in_mujoco(hector: RobotConfig) -> None:
    import prepare

    links = json.loads(prepare.robot_files(hector)["robot.json"])["links"]
    assert all(its["ground"] and its["friction"] == 1.0 for its in links.values())
    right = ["R_thigh", "R_calf", "R_toe"]
    assert [sorted(links[name]["links"]) for name in ("trunk", "L_hip", "L_toe")] == [[], [], sorted(right)]


@pytest.fixture(scope="module")
def world(hector: RobotConfig, model: mujoco.MjModel, tmp_path_factory) -> Any:
    pytest.importorskip("pybullet")
    pytest.importorskip("onnxruntime")
    import prepare
    from bullet import World

    folder = tmp_path_factory.mktemp("exported")
    for name, content in prepare.robot_files(hector).items():
        (folder / name).write_text(content, encoding="utf-8")
    servos = read_servos(model, hector)
    gains = {
        "kp": servos.kp.tolist(),
        "kd": servos.kd.tolist(),
        "torque_limit": servos.torque_high.tolist(),
        "time_constant": servos.time_constant.tolist(),
    }
    return World(folder, {"action": {"joints": list(hector.joints)}, "gains": gains}, ENGINE_DT)


def put(world: Any, model: mujoco.MjModel, pos: Any, quat: Any, joints: Any, linvel: Any = (0, 0, 0)) -> mujoco.MjData:
    """The same state in both engines."""
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7], data.qpos[7:], data.qvel[:3] = pos, quat, joints, linvel
    world.put_robot(list(pos), list(quat), list(linvel), joints)
    mujoco.mj_forward(model, data)
    return data


def fall_and_swing(world: Any, model: mujoco.MjModel, data: mujoco.MjData, targets: np.ndarray, time: float) -> Any:
    """What both engines make of servo targets over a while."""
    data.ctrl[:] = targets
    for _ in range(round(time / ENGINE_DT)):
        mujoco.mj_step(model, data)
    world.step(targets, time)
    return world.state()


def test_masses_and_joint_space_inertias_are_the_same(world, model: mujoco.MjModel) -> None:
    mass = [world.bullet.getDynamicsInfo(world.robot, link)[0] for link in world.link.values()]
    assert list(world.link) == [model.body(i).name for i in range(1, model.nbody)]
    np.testing.assert_allclose(mass, model.body_mass[1:], rtol=1e-12)
    rng = np.random.default_rng(2)
    for _ in range(3):
        angles = rng.uniform(-IN_REACH, IN_REACH, 10)
        data, M = put(world, model, (0, 0, 1), (1, 0, 0, 0), angles), np.zeros((16, 16))
        mujoco.mj_fullM(model, data, M)
        found = np.array(world.bullet.calculateMassMatrix(world.robot, angles.tolist()))
        np.testing.assert_allclose(found[6:, 6:], M[6:, 6:], rtol=0, atol=1e-12)


def test_joints_have_the_same_limits_axes_damping_and_friction(world, model: mujoco.MjModel) -> None:
    data = put(world, model, (0, 0, 1), (1, 0, 0, 0), np.linspace(-0.2, 0.2, 10))
    for joint in world.joints:
        _, name, *_, damping, friction, low, high, torque, _, link, axis, _, _, _ = world.bullet.getJointInfo(
            world.robot, joint
        )
        its = model.joint(name.decode())
        np.testing.assert_allclose([low, high], its.range, rtol=0, atol=1e-9)
        dof = its.dofadr[0]
        assert (damping, friction) == (np.ravel(model.dof_damping[dof])[0], model.dof_frictionloss[dof])
        assert torque == model.actuator(name.decode()).forcerange[1]
        state = world.bullet.getLinkState(world.robot, joint, computeForwardKinematics=1)
        x, y, z, w = state[1]  # of the frame of the principal inertias, in which PyBullet gives the axis
        turned = quat_rotate(np.array([[w, x, y, z]]), np.array([axis]))[0]
        np.testing.assert_allclose(turned, data.joint(name.decode()).xaxis, rtol=0, atol=1e-6, err_msg=str(name))
        assert link.decode() == model.body(its.bodyid[0]).name


def test_feet_are_in_the_same_place_at_random_poses(world, model: mujoco.MjModel, hector: RobotConfig) -> None:
    rng, (low, high) = np.random.default_rng(3), np.clip(model.jnt_range[1:], -1.5, 1.5).T
    for _ in range(10):
        quat = rng.normal(size=4)
        data = put(world, model, rng.normal(size=3), quat / np.linalg.norm(quat), rng.uniform(low, high))
        for foot in hector.feet:
            found = world.bullet.getLinkState(world.robot, world.link[foot], computeForwardKinematics=1)
            np.testing.assert_allclose(found[4], data.body(foot).xpos, rtol=0, atol=1e-6)
        state = world.state()
        np.testing.assert_allclose(state.pos, data.qpos[:3], rtol=0, atol=1e-6)
        np.testing.assert_allclose(state.rotation, data.body("trunk").xmat.reshape(3, 3), rtol=0, atol=1e-6)


def test_free_fall_and_swinging_legs_agree(world, model: mujoco.MjModel) -> None:
    """Weight, inertia, damping, dry friction, gains and limits of torque all count here."""
    world.put_ground(np.zeros((0, 5)))
    rng = np.random.default_rng(4)
    data = put(world, model, (0, 0, 5), (1, 0, 0, 0), rng.uniform(-IN_REACH, IN_REACH, 10), (1.0, 0.2, 0.5))
    targets = rng.uniform(-IN_REACH, IN_REACH, 10)
    targets[[2, 3, 7, 8]] = -1.2, 2.2, 0.9, -1.5  # thighs and knees at their greatest torque
    state = fall_and_swing(world, model, data, targets, 0.3)
    assert np.abs(data.qpos[7:] - targets).max() < 1.0 < np.abs(data.qpos[7:]).max()
    np.testing.assert_allclose(state.pos, data.qpos[:3], rtol=0, atol=1e-3)
    np.testing.assert_allclose(state.joint_pos, data.qpos[7:], rtol=0, atol=2e-2)
    np.testing.assert_allclose(state.quat, data.qpos[3:7], rtol=0, atol=5e-3)


STIFF, SOFT = (0.002, 1.0), (0.02, 1.0)  # MuJoCo's solref: time constant, s, and damping ratio; its default is soft


@pytest.mark.parametrize(("solref", "base", "foot"), [(STIFF, 1e-3, 2e-3), (SOFT, 2e-3, 0.012)])
def test_a_robot_that_lands_and_slides_agrees(world, hector: RobotConfig, solref, base: float, foot: float) -> None:
    """Falling onto flat ground at 1 m/s, then crouching there: contacts and friction.

    PyBullet's contacts are rigid. With MuJoCo's made stiff both agree; in soft ones soles sink and creep.
    """
    world.put_ground(np.array([[-2.0, 2.0, -1.0, 1.0, 0.0]]))
    model = build_model(hector, ENGINE_DT, terrain_boxes=1)
    box = model.geom("terrain_0").id
    model.geom_pos[box], model.geom_size[box], model.geom_rbound[box] = (0, 0, -1), (2, 1, 1), 3.0
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_OVERRIDE
    model.opt.o_solref[:] = solref
    data = put(world, model, (0, 0, 0.52), (1, 0, 0, 0), np.zeros(10), (1.0, 0.0, 0.0))
    state = fall_and_swing(world, model, data, np.zeros(10), 0.16)
    mujoco.mj_kinematics(model, data)
    toe = world.bullet.getLinkState(world.robot, world.link["L_toe"], computeForwardKinematics=1)[4]
    assert len(world.bullet.getContactPoints(world.robot)) >= 4 and 0.4 < state.pos[2] < 0.43
    np.testing.assert_allclose(state.pos, data.qpos[:3], rtol=0, atol=base)
    np.testing.assert_allclose(toe, data.body("L_toe").xpos, rtol=0, atol=foot)
    assert (np.abs(toe - data.body("L_toe").xpos).max() > 5e-3) == (solref == SOFT)


# ---------------------------------------------------------------------- the program


def test_a_track_is_played_to_its_fall_and_the_table_says_where(world, tmp_path: Path) -> None:
    import run

    crouch = np.full(10, 0.2)
    controller = SimpleNamespace(
        info={"control_dt": 0.03}, reset=lambda: None, step=lambda _: crouch, last_action=np.zeros(10)
    )
    observer = SimpleNamespace(begin=lambda track: None, observe=lambda *_: None, boxes=np.array([[-2, 2, -1, 1, 0.0]]))
    start = {"base_pos": [0, 0, 0.5], "base_quat": [1, 0, 0, 0], "base_linvel": [0, 0, 0], "joint_pos": [0.0] * 10}
    data = {"steps": 200, "track_length": 10.0, "fall": {"min_height": 0.3, "fill_gaps": True}}
    track = {"seed": 3, "start": start, "modes": [["pace", 9.0], ["leap", 10.0]], "boxes": [], "spans": []}
    result = run.play(world, controller, observer, data, track)
    assert (result.seed, result.mode) == (3, "pace")
    assert result.fell in ("tilted", "low but upright")
    assert 0.0 < result.seconds < 6.0 and abs(result.distance) < 1.0
    text = run.table([result, replace(result, fell="", distance=3.0), replace(result, fell="")])
    assert "no fall    0.67   95 % interval 0.21 .. 0.94" in text
    assert f"fell in    1 x pace, {result.fell}" in text


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "usage: python run.py FOLDER"),
        (
            ["there", "track=3"],
            r"unknown key 'track' \(known: tracks, engine_dt, video, out\)\. Did you mean 'tracks'\?",
        ),
        (["there", "tracks=many"], "'tracks' must be a whole number, found 'many'"),
        (["there", "tracks=0"], "'tracks' must be at least 1"),
        (["there", "engine_dt=0.00035"], "'engine_dt' is 0.00035 s, of which a control step, 0.03 s, is no multiple"),
        (["there"], "there: no controller.py; ogmp-export writes one"),
    ],
)
def test_mistakes_of_the_command_line_are_a_sentence(arguments: list[str], sentence: str) -> None:
    pytest.importorskip("pybullet")
    pytest.importorskip("onnxruntime")
    import run

    with pytest.raises(ValueError, match=sentence):
        if arguments[1:] == ["engine_dt=0.00035"]:
            run.check_engine_dt(run.settings(arguments).engine_dt, 0.03)
        run.main(arguments)
