"""What meets the ground: feet that can, feet that cannot, and sensors that tell one from the other."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from helpers.robots import COMPILER, FEET, GEOMS, PUP, TRUNK_SENSOR, variant, with_attributes
from ogmp_sb3.config.load import load_robot
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.ground_contacts import body_contact_addresses, geom_extents
from ogmp_sb3.env.robot_check import stand
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.simulation import Simulation

DT = 0.002  # s
NOMINAL = np.array(PUP.nominal_joints)
FLAT = (-5.0, 5.0, -5.0, 5.0, 0.0)
SOLE = '<geom class="foot"/>'
WITHOUT_FEET = '<inertial pos="0 0 0" mass="0.05" diaginertia="0.0001 0.0001 0.0001"/>'


def stands(robot: RobotConfig) -> bool:
    (found,) = stand(robot, DT, (0.0,), seconds=0.5)
    return found.feet_contact and not found.body_contact and abs(found.height - 0.25) < 0.01


def felt(robot: RobotConfig, base: tuple[float, float, float], turned: bool = False) -> bool:
    """Whether a robot that was put down somewhere has touched the ground with more than its feet."""
    sim = Simulation(robot, 1, DT, 1, 1)
    rows = np.arange(1)
    sim.set_terrain(rows, np.array([[FLAT]]))
    sim.place(rows, np.array([base]), NOMINAL)
    if turned:
        sim.qpos[0, 3:7] = 0.0, 1.0, 0.0, 0.0
    sim.step(None, 30)
    return bool(sim.body_contact()[0])


def can_be_felt(robot: RobotConfig) -> bool:
    """On its back, but neither on its feet nor in the air."""
    base = (0.0, 0.0, 0.05)
    return felt(robot, base, turned=True) and not felt(robot, (0.0, 0.0, 0.26)) and not felt(robot, (0.0, 0.0, 3.0))


@pytest.mark.parametrize(
    ("changes", "bits"),
    [
        ([], 1),
        ([(GEOMS, with_attributes(GEOMS, 'group="1"'))], 1),
        ([(FEET, with_attributes(FEET, 'contype="1" conaffinity="0"'))], 1),
        ([(FEET, with_attributes(FEET, 'contype="4" conaffinity="0"'))], 2**31 - 1),
        ([(GEOMS, GEOMS.replace('"0" conaffinity="1"', '"2" conaffinity="2"'))], 2**31 - 1),
        ([(FEET, with_attributes(FEET, 'gap="0.1"'))], 1),
        ([(SOLE, "<body><geom class='foot'/></body>")], 1),
    ],
    ids=["as it is", "group 1", "contype 1", "contype 4", "all of 2 and 2", "gap", "below a foot"],
)
def test_a_robot_stands_whatever_the_bits_and_groups_of_its_geoms(
    changes: list[tuple[str, str]], bits: int, tmp_path: Path
) -> None:
    robot = variant(tmp_path, *changes)
    ground = build_model(robot, DT, 2).geom("terrain_1")
    assert (ground.contype[0], ground.conaffinity[0]) == (bits, bits)
    assert stands(robot)
    assert can_be_felt(robot)


@pytest.mark.parametrize(
    ("found", "written"),
    [
        (SOLE, SOLE.replace("/>", ' conaffinity="0"/>')),
        (SOLE, WITHOUT_FEET),
        (SOLE, f"{WITHOUT_FEET}<geom class='foot' contype='0' conaffinity='0' group='3'/>"),
    ],
)
def test_a_foot_without_a_geom_that_collides_is_named(found: str, written: str, tmp_path: Path) -> None:
    robot = variant(tmp_path, (found, written), once=True)
    with pytest.raises(ValueError, match=r"pup\.xml: foot 'FL_foot' cannot touch the ground: neither it nor a body"):
        build_model(robot, DT, 1)


def test_a_foot_that_is_kept_from_the_world_is_named(tmp_path: Path) -> None:
    exclude = ("<sensor>", '<contact><exclude body1="RL_foot" body2="world"/></contact><sensor>')
    with pytest.raises(ValueError, match="foot 'RL_foot' cannot touch the ground: an <exclude> keeps it from the"):
        build_model(variant(tmp_path, exclude), DT, 1)


def test_an_exclude_of_two_bodies_of_the_robot_keeps_none_from_the_ground(tmp_path: Path) -> None:
    exclude = ("<sensor>", '<contact><exclude body1="FL_foot" body2="FR_foot"/></contact><sensor>')
    assert stands(variant(tmp_path, exclude))


OTHER_SENSORS = [
    *(
        f'<contact name="trunk_contact" {between} num="1" data="{data}"/>'
        for between in (
            'geom1="trunk" body2="world"',
            'subtree1="trunk" body2="world"',
            'subtree1="trunk"',
            'body1="trunk" body2="FL_foot"',
            'body1="trunk"',
            'body1="world" body2="trunk"',
            'site="spot"',
        )
        for data in ("found", "force", "dist")
    ),
    '<contact name="trunk_contact" body1="trunk" body2="world" num="1" data="dist normal"/>',
    '<contact name="trunk_contact" body1="trunk" body2="world" num="1" data="found" delay="0.2" nsample="120"/>',
    "",
]


@pytest.mark.parametrize("sensor", OTHER_SENSORS)
def test_sensors_of_other_tool_chains_are_neither_ours_nor_in_the_way(sensor: str, tmp_path: Path) -> None:
    spot = ('<geom name="trunk"', '<site name="spot" size="0.3"/><geom name="trunk"')
    model = build_model(variant(tmp_path, (TRUNK_SENSOR, sensor), spot), DT, 1)
    ours = body_contact_addresses(model, PUP)
    (trunk,) = np.flatnonzero(model.sensor_adr == ours[-1])  # made by us, so the last
    assert len(ours) == 9
    assert model.sensor_objid[trunk] == model.body("trunk").id and model.sensor_refid[trunk] == 0
    assert (model.sensor("trunk_contact").adr[0] not in ours) if sensor else model.nsensor == 13


@pytest.mark.parametrize("sensor", ['subtree1="trunk"', 'body1="trunk" body2="FL_foot"'])
def test_only_bodies_on_the_ground_are_felt_whatever_other_sensors_say(sensor: str, tmp_path: Path) -> None:
    other = f'<contact name="trunk_contact" {sensor} num="1" data="found"/>'
    assert can_be_felt(variant(tmp_path, (TRUNK_SENSOR, other)))


@pytest.mark.parametrize(
    ("found", "written"),
    [
        ('<body name="FL_shank"', '<body name="FL_shank"'),
        ('<body name="FL_shank"', "<body"),
        (COMPILER, with_attributes(COMPILER, 'fusestatic="true"')),
    ],
    ids=["names", "a body without a name", "feet fused with shanks"],
)
def test_a_robot_without_sensors_feels_what_the_example_feels(found: str, written: str, tmp_path: Path) -> None:
    mjcf = PUP.mjcf_path.read_text(encoding="utf-8")
    sensors = mjcf[mjcf.index("  <sensor>") : mjcf.index("</sensor>") + len("</sensor>")]
    robot = variant(tmp_path, (sensors, ""), (found, written))
    model, example = build_model(robot, DT, 1), build_model(PUP, DT, 1)
    of_bodies = model.sensor_objid[np.isin(model.sensor_adr, body_contact_addresses(model, robot))]
    theirs = example.sensor_objid[np.isin(example.sensor_adr, body_contact_addresses(example, PUP))]
    assert set(of_bodies.tolist()) == set(theirs.tolist())
    assert can_be_felt(robot)


def test_a_gap_is_no_contact(tmp_path: Path) -> None:
    """MuJoCo lists contacts within it, without a force."""
    wide = variant(tmp_path, (GEOMS, with_attributes(GEOMS, 'gap="0.3"')))
    assert not felt(wide, (0.0, 0.0, 0.26))


def test_what_touches_only_the_robot_itself_needs_no_sensor(tmp_path: Path) -> None:
    thigh = '<geom type="capsule" size="0.020" fromto="0 0 -0.02 0 0 -0.14" mass="0.35" material="coat"/>'
    robot = variant(tmp_path, (thigh, with_attributes(thigh, 'contype="2" conaffinity="2"')))
    model = build_model(robot, DT, 1)
    assert model.geom("terrain_0").contype[0] == 1
    assert model.nsensor == build_model(PUP, DT, 1).nsensor


def test_the_shipped_robot_brings_all_its_sensors() -> None:
    hector = load_robot("hector")
    model = build_model(hector, DT, 1)
    names = [model.sensor(i).name for i in range(model.nsensor)]
    assert all(names) and len(names) == len(mujoco.MjModel.from_xml_path(str(hector.mjcf_path)).sensor_adr)
    body = [name for name, adr in zip(names, model.sensor_adr, strict=True) if "toe" not in name]
    np.testing.assert_array_equal(body_contact_addresses(model, hector), [model.sensor(name).adr[0] for name in body])


def test_a_turned_mesh_reaches_as_far_as_its_vertices_and_not_its_box() -> None:
    """A diamond, turned until a corner of its box is below."""
    vertices = "0.1 0 0  -0.1 0 0  0 0.02 0  0 -0.02 0  0 0 0.09  0 0 -0.09"
    model = mujoco.MjModel.from_xml_string(
        f'''<mujoco><asset><mesh name="diamond" vertex="{vertices}"/></asset><worldbody>
        <geom type="mesh" mesh="diamond" pos="1 2 3" euler="0 45 0"/><geom size="0.1" pos="0 0 1"/>
        </worldbody></mujoco>'''
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    low, high = geom_extents(data, np.arange(2))
    reach = 0.1 / np.sqrt(2)
    assert low == pytest.approx(np.array([[1 - reach, 1.98, 3 - reach], [-0.1, -0.1, 0.9]]), abs=1e-6)
    assert high == pytest.approx(np.array([[1 + reach, 2.02, 3 + reach], [0.1, 0.1, 1.1]]), abs=1e-6)
