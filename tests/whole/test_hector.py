"""The robot in `robots/hector`: its numbers, its mechanics and its contact sensors, without the simulator."""

from itertools import combinations

import mujoco
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from helpers.paths import ROOT

HECTOR = ROOT / "robots" / "hector"
GRAVITY = 9.81  # m/s²
TOTAL_MASS = 14.046  # kg

# The table, written down a second time on purpose. Body: mass in kg, offset from its parent in m (left side).
BODIES = {
    "trunk": (5.89, (0.0, 0.0, 0.5)),
    "hip": (0.874, (0.0, 0.047, -0.1265)),
    "hip2": (0.745, (0.0465, 0.015, -0.0705)),
    "thigh": (1.942, (-0.06, 0.018, 0.0)),
    "calf": (0.303, (0.0, 0.0, -0.22)),
    "toe": (0.214, (0.0, 0.0, -0.22)),
}
# Joint: its body, axis, range on the left in rad, damping (and frictionloss), torque limit in N m.
JOINTS = {
    "hip_yaw": ("hip", (0, 0, 1), (-0.261799, 0.261799), 0.1, 30.0),
    "hip_roll": ("hip2", (1, 0, 0), (-0.523599, 0.261799), 0.1, 30.0),
    "thigh_pitch": ("thigh", (0, 1, 0), (-3.14, 3.14), 0.0, 30.0),
    "knee": ("calf", (0, 1, 0), (-3.14, 3.14), 0.0, 50.0),
    "ankle": ("toe", (0, 1, 0), (-1.4, 1.4), 0.0, 30.0),
}
PRINCIPAL_INERTIA = {  # kg m²
    "trunk": (0.0479073, 0.03785748, 0.02538835),
    "L_hip": (0.00147219, 0.00132639, 0.000517101),
    "R_hip": (0.00144737, 0.00130361, 0.000518878),
    "L_hip2": (0.000770832, 0.000552938, 0.000493077),
    "R_hip2": (0.000783544, 0.000603818, 0.000531245),
    **{f"{side}_thigh": (0.0111784, 0.0106783, 0.00282909) for side in "LR"},
    **{f"{side}_calf": (0.001911, 0.00191038, 6.8352e-05) for side in "LR"},
    **{f"{side}_toe": (0.000290752, 0.000249491, 5.7298e-05) for side in "LR"},
}
CENTRE_OF_MASS = {  # m, in the body's frame
    "trunk": (0, 0, 0),
    "L_hip": (0.0651881, 0.0105682, -0.05877),
    "R_hip": (0.0651881, -0.011743, -0.05877),
    "L_hip2": (-0.0565847, -0.0143919, 0),
    "R_hip2": (-0.0565847, 0.0117826, 0),
    **{f"{s}_thigh": (-4.85963e-05, y * 0.0199702, -0.0592828) for s, y in (("L", 1), ("R", -1))},
    **{f"{s}_calf": (0, y * 0.020417, -0.1141) for s, y in (("L", 1), ("R", -1))},
    **{f"{s}_toe": (0.010569, y * 0.017949, -0.017118) for s, y in (("L", 1), ("R", -1))},
}
INERTIA_QUAT = {  # wxyz, principal axes in the body's frame
    "trunk": (1, 0, 0, 0),
    "L_hip": (-0.0733308, 0.865238, 0.13671, 0.476756),
    "R_hip": (0.054396, 0.871604, -0.102394, 0.476301),
    "L_hip2": (0.490371, 0.490371, 0.509447, 0.509447),
    "R_hip2": (0.554078, 0.554078, 0.439315, 0.439315),
    "L_thigh": (0.98238, -0.186894, 0.000253273, 0.000716486),
    "R_thigh": (0.98238, 0.186894, 0.000253273, -0.000716486),
    **{f"{side}_calf": (1, 0, 0, 0) for side in "LR"},
    **{f"{side}_toe": (0.5, 0.5, 0.5, 0.5) for side in "LR"},
}
# Half-sizes in m (cylinder: radius, half-length) and centre in the body's frame (left side).
COLLISION = {
    "thigh": ((0.03, 0.0175, 0.09), (0.0, 0.0175, -0.09)),
    "calf": ((0.015, 0.1, 0.0), (0.0, 0.02, -0.11)),
    "toe": ((0.075, 0.01, 0.02), (0.01, 0.0194, -0.02)),
}
JOINT_NAMES = [f"{side}_{joint}" for side in "LR" for joint in JOINTS]
FEET = {"L_toe", "R_toe"}
TOUCHING = {"trunk", *(f"{side}_{body}" for side in "LR" for body in ("hip", "thigh", "calf", "toe"))}


def mirrored(vector: tuple[float, ...], side: str) -> np.ndarray:
    """The vector of the left side, with y turned round for the right."""
    return np.array(vector) * (1, 1 if side == "L" else -1, 1)


def robot_on_ground() -> mujoco.MjModel:
    """HECTOR and one terrain box with its top at z = 0, added as the simulator adds it."""
    spec = mujoco.MjSpec.from_file(str(HECTOR / "hector.xml"))
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[10, 10, 0.5],
        pos=[0, 0, -0.5],
        contype=1,
        conaffinity=1,
    )
    return spec.compile()


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return robot_on_ground()


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    """The nominal pose, all derived fields computed."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture(scope="module")
def robot() -> dict:
    return yaml.safe_load((HECTOR / "robot.yaml").read_text(encoding="utf-8"))


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[str]:
    """Names of the bodies whose contact sensor sees the terrain."""
    mujoco.mj_forward(model, data)  # sensors lag one step behind qpos
    return {name for name in TOUCHING if data.sensor(f"{name}_contact").data[0] > 0}


def ground_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Sum of the normal contact forces, N; all normals point up here."""
    mujoco.mj_forward(model, data)
    force = np.zeros((data.ncon, 6))
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force[contact])
    return float(force[:, 0].sum())


def gravity_compensation(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Servo targets that hold the nominal pose at rest, the ground pressing under the centre of mass.

    :return: targets in rad, shape (10,): static joint torque over kp
    """
    torque = data.qfrc_bias[6:].copy()
    com = data.body("trunk").subtree_com
    sole = {side: data.site(f"{side}_sole").xpos for side in "LR"}
    for side, other in ("LR", "RL"):
        share = (com[1] - sole[other][1]) / (sole[side][1] - sole[other][1])
        pressed = np.array([com[0], sole[side][1], sole[side][2]])
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, pressed, model.body(f"{side}_toe").id)
        torque -= jacobian[2, 6:] * share * TOTAL_MASS * GRAVITY
    return torque / 30.0


# ---- the table ----


def test_masses_and_offsets_are_those_of_the_table(model: mujoco.MjModel) -> None:
    for name in PRINCIPAL_INERTIA:
        mass, offset = BODIES[name.split("_")[-1]]
        side = "R" if name.startswith("R") else "L"
        assert model.body(name).mass[0] == mass
        np.testing.assert_allclose(model.body(name).pos, mirrored(offset, side), atol=1e-12)
    assert model.nbody == 1 + len(PRINCIPAL_INERTIA)
    assert model.body_mass.sum() == pytest.approx(TOTAL_MASS, abs=1e-9)


@pytest.mark.parametrize("name", PRINCIPAL_INERTIA)
def test_centres_of_mass_and_inertias_are_those_of_the_table(model: mujoco.MjModel, name: str) -> None:
    np.testing.assert_allclose(model.body(name).inertia, PRINCIPAL_INERTIA[name], rtol=1e-6)
    np.testing.assert_allclose(model.body(name).ipos, CENTRE_OF_MASS[name], atol=1e-9)
    np.testing.assert_allclose(model.body(name).iquat, INERTIA_QUAT[name], atol=1e-6)


def test_joints_and_servos_are_those_of_the_table(model: mujoco.MjModel) -> None:
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", *JOINT_NAMES]
    assert [model.actuator(i).name for i in range(model.nu)] == JOINT_NAMES
    for name in JOINT_NAMES:
        side, (body, axis, limits, damping, torque) = name[0], JOINTS[name[2:]]
        joint, servo = model.joint(name), model.actuator(name)
        if side == "R" and name.endswith("roll"):
            limits = (-limits[1], -limits[0])
        assert model.body(joint.bodyid[0]).name == f"{side}_{body}"
        np.testing.assert_array_equal(joint.axis, axis)
        np.testing.assert_allclose(joint.range, limits)
        assert (joint.damping[0], joint.frictionloss[0]) == (damping, damping)
        assert servo.trnid[0] == joint.id
        assert (servo.gainprm[0], *servo.biasprm[:3]) == (30.0, 0.0, -30.0, -0.5)
        np.testing.assert_array_equal(servo.forcerange, (-torque, torque))
        assert not servo.ctrllimited[0]


def test_servo_torque_is_pd_up_to_the_limit(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qvel[6:] = 0.1
    data.ctrl[:] = [0.5, -0.5, -2.0, -2.0, 2.0, 0.1, -0.1, 1.0, 2.0, -1.0]
    mujoco.mj_forward(model, data)
    limit = np.array([JOINTS[name[2:]][-1] for name in JOINT_NAMES])
    np.testing.assert_allclose(data.actuator_force, np.clip(30 * data.ctrl - 0.5 * 0.1, -limit, limit))
    assert data.actuator_force[3] == -50.0 and data.actuator_force[4] == 30.0


def test_collision_shapes_are_those_of_the_table(model: mujoco.MjModel) -> None:
    np.testing.assert_array_equal(model.geom("trunk_collision").size, (0.0625, 0.095, 0.124))
    for side in "LR":
        np.testing.assert_array_equal(model.geom(f"{side}_hip_collision").size[:2], (0.045, 0.02))
        for body, (size, position) in COLLISION.items():
            geom = model.geom(f"{side}_{body}_collision")
            np.testing.assert_array_equal(geom.size, size)
            np.testing.assert_allclose(geom.pos, mirrored(position, side))
    colliding = (model.geom_contype | model.geom_conaffinity) > 0
    np.testing.assert_array_equal(model.geom_friction[colliding, 0], 1.0)


def test_the_crouch_has_equal_links_vertical_legs_and_flat_soles(data: mujoco.MjData) -> None:
    for side in "LR":
        hip, knee, ankle = (data.body(f"{side}_{body}").xpos for body in ("thigh", "calf", "toe"))
        assert np.linalg.norm(hip - knee) == pytest.approx(0.22)
        assert np.linalg.norm(knee - ankle) == pytest.approx(0.22)
        np.testing.assert_allclose(ankle[:2], hip[:2], atol=1e-5)
        assert knee[0] < hip[0] - 0.17  # the knees point backwards, as a bird's ankles do
        np.testing.assert_allclose(data.body(f"{side}_toe").xmat.reshape(3, 3), np.eye(3), atol=1e-5)
        assert ankle[2] - data.site(f"{side}_sole").xpos[2] == pytest.approx(0.04, abs=1e-6)
        assert 0 < data.site(f"{side}_sole").xpos[2] < 0.005  # the nominal height leaves 4 mm of air
    np.testing.assert_array_equal(data.site("imu").xpos, data.body("trunk").xpos)


def test_left_and_right_are_mirror_images(model: mujoco.MjModel) -> None:
    mirror = np.diag([1.0, -1.0, 1.0])
    for body in set(BODIES) - {"trunk"}:
        left, right = model.body(f"L_{body}"), model.body(f"R_{body}")
        tensor = {}
        for side in (left, right):
            axes = Rotation.from_quat(side.iquat, scalar_first=True).as_matrix()
            tensor[side.id] = axes @ np.diag(side.inertia) @ axes.T
        np.testing.assert_array_equal(left.mass, right.mass)
        np.testing.assert_array_equal(mirror @ left.pos, right.pos)
        np.testing.assert_array_equal(left.quat, right.quat)
        exact = body not in {"hip", "hip2"}  # the real hips carry their motors asymmetrically
        np.testing.assert_allclose(mirror @ left.ipos, right.ipos, atol=1e-12 if exact else 3e-3)
        difference = mirror @ tensor[left.id] @ mirror - tensor[right.id]
        assert np.abs(difference).max() < (1e-9 if exact else 1.2e-4)


# ---- robot.yaml ----


def test_yaml_names_what_the_model_holds(model: mujoco.MjModel, robot: dict) -> None:
    assert (HECTOR / robot["mjcf"]).is_file()
    assert robot["joints"] == JOINT_NAMES
    assert set(robot["feet"]) == FEET
    assert model.body(robot["base"]).jntnum[0] == 1 and model.joint(0).type[0] == mujoco.mjtJoint.mjJNT_FREE
    home = model.key("home").qpos
    np.testing.assert_array_equal(home, [0, 0, robot["nominal_height"], 1, 0, 0, 0, *robot["nominal_joints"]])
    np.testing.assert_array_equal(model.key("home").ctrl, robot["nominal_joints"])
    assert robot["leg_length"] == 0.459


def test_yaml_holds_the_models_srb(model: mujoco.MjModel, data: mujoco.MjData, robot: dict) -> None:
    """From the joint-space inertia: its free-joint block is the whole robot's, about the trunk origin."""
    full = np.zeros((model.nv, model.nv))
    for column, unit in zip(full, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    mass, offset = full[0, 0], data.body("trunk").subtree_com - data.body("trunk").xpos
    inertia = full[3:6, 3:6] - mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    assert robot["srb"]["mass"] == pytest.approx(mass, rel=1e-6)
    np.testing.assert_allclose(robot["srb"]["inertia"], np.diag(inertia), rtol=3e-6)


# ---- mechanics ----


@pytest.mark.parametrize("physics_dt, turned", [(0.002, 0.05), (0.0002, 0.005)])
def test_flight_is_ballistic_and_keeps_its_angular_momentum(physics_dt: float, turned: float) -> None:
    """Servos thrash the legs about; no internal force may move the centre of mass or turn the whole.

    A first-order integrator: in 0.3 s the angular momentum drifts by 3.8 % at 2 ms and 0.4 % at 0.2 ms.
    """
    model = robot_on_ground()
    model.opt.timestep = physics_dt
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[2] = 3.0
    data.qvel[:6] = [1.0, -0.5, 2.0, 0.5, 2.0, -0.3]
    data.qvel[6:] = rng.uniform(-2, 2, 10)
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    trunk = data.body("trunk")
    start, velocity = trunk.subtree_com.copy(), trunk.subtree_linvel.copy()
    momentum = trunk.subtree_angmom.copy()
    for _ in range(10):
        data.ctrl[:] = rng.uniform(-0.5, 0.5, 10)
        mujoco.mj_step(model, data, round(0.03 / physics_dt))
    assert not touching(model, data)
    assert np.abs(data.qpos[7:]).max() > 0.2
    mujoco.mj_subtreeVel(model, data)
    # Velocity first, then position (semi-implicit Euler): a thrown point falls by g t (t + dt) / 2.
    time = data.time
    flown = velocity * time - [0, 0, GRAVITY * time * (time + physics_dt) / 2]
    np.testing.assert_allclose(trunk.subtree_com, start + flown, atol=1e-3)
    assert np.linalg.norm(trunk.subtree_angmom - momentum) < turned * np.linalg.norm(momentum)


def test_feet_carry_the_weight_if_gravity_is_compensated(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """It stands for a second and falls later: there is no balance control, only a stiffness of 30 N m/rad."""
    data.ctrl[:] = gravity_compensation(model, data)
    forces = []
    for step in range(500):
        mujoco.mj_step(model, data)
        assert data.qpos[2] == pytest.approx(0.5, abs=0.03)
        if step >= 100:
            forces.append(ground_force(model, data))
    assert np.mean(forces) == pytest.approx(TOTAL_MASS * GRAVITY, rel=0.03)
    assert np.linalg.norm(data.qpos[:2]) < 0.04


def test_zero_targets_sag_and_fall_within_a_second(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """A policy must push: 11.5 N m in each knee hold the crouch, that is a target 0.38 rad away from it."""
    assert gravity_compensation(model, data)[[3, 8]] == pytest.approx(11.5 / 30, rel=0.02)
    mujoco.mj_step(model, data, 100)
    assert 0.35 < data.qpos[2] < 0.45
    mujoco.mj_step(model, data, 400)
    assert data.qpos[2] < 0.3
    assert not data.warning.number.any()


# ---- contacts ----


def test_every_colliding_body_has_a_contact_sensor_and_there_are_no_others(model: mujoco.MjModel) -> None:
    colliding = model.geom_bodyid[(model.geom_contype | model.geom_conaffinity) > 0]
    assert {model.body(i).name for i in colliding} == TOUCHING | {"world"}
    assert {model.sensor(i).name for i in range(model.nsensor)} == {f"{name}_contact" for name in TOUCHING}
    assert model.nsensordata == len(TOUCHING)


def test_only_terrain_and_the_other_leg_can_be_touched(model: mujoco.MjModel) -> None:
    pairs = set()
    for one, two in combinations(range(model.ngeom), 2):
        if (model.geom_contype[one] & model.geom_conaffinity[two]) | (
            model.geom_contype[two] & model.geom_conaffinity[one]
        ):
            pairs.add(frozenset(model.body(model.geom_bodyid[i]).name for i in (one, two)))
    leg = ("thigh", "calf", "toe")
    expected = {frozenset({"world", body}) for body in TOUCHING}
    expected |= {frozenset({f"L_{left}", f"R_{right}"}) for left in leg for right in leg}
    assert pairs == expected


def test_standing_is_felt_by_the_feet_alone(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    assert touching(model, data) == set()  # 4 mm of air under the soles
    data.ctrl[:] = gravity_compensation(model, data)
    mujoco.mj_step(model, data, 100)
    assert touching(model, data) == FEET


def test_lying_is_felt_by_the_trunk(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mujoco.mj_step(model, data, 1500)
    assert "trunk" in touching(model, data)
    assert data.qpos[2] < 0.15


def test_crossed_legs_touch_each_other_not_the_terrain(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qpos[2] = 2.0
    for name, angle in (("L_hip_roll", -0.33), ("R_hip_roll", 0.33)):  # both inwards
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    touched = {model.body(model.geom_bodyid[i]).name for i in data.contact.geom.ravel()}
    assert {"L_toe", "R_toe"} <= touched
    assert touching(model, data) == set()
