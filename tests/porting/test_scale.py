"""Tasks scaled to other robots: beside what physics says of a robot that is the same, but larger."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.load import load_robot, load_task
from ogmp_sb3.config.robot import SRB, RobotConfig, ServoConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.porting.scale import GROWTH, HEIGHT, Similar, scaled
from ogmp_sb3.porting.task_yaml import task_yaml, yaml_number

HECTOR = load_robot("hector")


def larger(length: float, mass: float, **fields: Any) -> RobotConfig:
    """A robot like HECTOR with legs that are longer, and a mass that is greater."""
    return replace(
        HECTOR,
        leg_length=length * HECTOR.leg_length,
        nominal_height=length * HECTOR.nominal_height,
        srb=SRB(mass=mass * HECTOR.srb.mass, inertia=HECTOR.srb.inertia),
        **fields,
    )


def changes(task: str, robot: RobotConfig) -> dict[str, Any]:
    return scaled(read_task(find("task", task)), load_task(task), robot)


@pytest.mark.parametrize("task", ["parkour", "dive", "parkour_robot", "stairs"])
def test_nothing_changes_for_the_same_robot(task: str) -> None:
    assert changes(task, HECTOR) == {}


def test_four_times_as_long_legs_take_twice_the_time_for_four_times_the_way() -> None:
    found = changes("parkour", larger(4.0, 64.0))
    assert found["modes"]["pace"] == {"v": [1.2, 3.6], "length": [1.6, 4.8]}
    assert found["modes"]["jump"] == {
        "w": [1.2, 2.0], "h": [0.8, 1.4], "v": 2.4, "run_up": 1.8, "lead": 0.2, "tail": 0.8,
    }  # fmt: skip
    assert found["curriculum"]["modes"] == {"pace": {"v": 1.6}, "jump": {"h": [0.08, 0.2]}, "leap": {"w": [0.2, 0.4]}}
    assert found["gait"] == {"height": 2.2, "cycle": 0.5} and found["horizon"] == 60
    assert found["terminations"] == found["evaluation"]["terminations"] == {"fall": {"min_height": 1.2}}
    assert found["observations"] == {"height_scan": {"spacing": 0.16}}
    assert found["rewards"] == {"position_tracking": {"sharpness": 1.25}, "torque_regulation": {"sharpness": 3.91e-05}}
    assert found["bound"] == {"x": 0.25}  # an error of four times the length deviates as much


def test_corresponding_errors_and_forces_cost_the_same() -> None:
    """The weight of a state times its square is the same for robots in corresponding states, and so is an input's."""
    base, grow = read_task(find("task", "parkour"))["oracle_params"]["lqr"], Similar(4.0, 64.0, 4.0)
    found = changes("parkour", larger(4.0, 64.0))["oracle_params"]["lqr"]
    for name, unit in (("z", "m"), ("vx", "m/s"), ("wx", "rad/s")):
        assert found["Q"][name] * grow.factor(unit) ** 2 == pytest.approx(base["Q"][name], rel=5e-3)
    for name, unit in (("fz", "N"), ("mx", "N m")):
        assert found["R"][name] * grow.factor(unit) ** 2 == pytest.approx(base["R"][name], rel=5e-3)


def test_who_stands_low_on_long_legs_falls_lower() -> None:
    low = replace(larger(4.0, 64.0), nominal_height=2.0 * HECTOR.nominal_height)
    found = changes("parkour", low)
    assert found["terminations"] == {"fall": {"min_height": 0.6}} and found["gait"]["height"] == 1.1
    assert found["modes"]["jump"]["h"] == [0.8, 1.4]


def test_the_phases_of_a_dive_and_its_defaults_are_scaled_too() -> None:
    found = changes("dive", larger(4.0, 64.0))
    assert found["modes"]["flip"] == {"h": [4.0, 7.0], "push": 1.0, "rate": 4.47, "v": 2.0, "block": 1.6}
    assert found["modes"]["settle"] == {"time": 2.4}
    assert set(found["oracle_params"]["preview"]["Q"]) == {"stance", "flight"}
    assert found["bound"] == {"z": 0.25, "wx": 0.05, "wy": 0.05}


def test_stiff_servos_make_small_actions_and_noise() -> None:
    """HECTOR's give all of their torque at 1 rad; those of eight times the gain at an eighth."""
    stiff = ServoConfig(kp=(240.0,) * 10, kd=(1.0,) * 10, torque=(30.0,) * 10)
    found = changes("parkour", replace(HECTOR, servos=stiff))
    assert found == {"action": {"scale": 0.8, "noise": 0.0163}}


def test_units_are_those_that_are_known_and_of_parameters_that_are_there() -> None:
    for kind in registry.KINDS:
        for name in kind.names():
            units = kind.units(name)
            assert set(units) <= set(kind.parameters(name)), name
            assert set(units.values()) <= {*GROWTH, HEIGHT}, name


def test_the_file_says_what_was_scaled_and_is_read_back(tmp_path: Path) -> None:
    found = changes("parkour", larger(2.0, 8.0))
    text = task_yaml("parkour", "hector", "parkour", found, Similar(2.0, 8.0, 2.0))
    assert "legs are 2.00 times as long" in text and max(map(len, text.splitlines())) <= 120
    data = yaml.safe_load(text)
    assert {key: data[key] for key in found} == found
    (tmp_path / "big.yaml").write_text(text, encoding="utf-8")
    task = load_task(str(tmp_path / "big.yaml"))
    assert task.gait.height == 1.1 and task.mode_ranges["jump"]["lead"].low == 0.1
    assert task.mode_ranges["pace"]["v"].high == pytest.approx(2.55)


@pytest.mark.parametrize("value", [1.77e-05, 2e-05, 1e-4, 4830.0, 0.5, 1e10, 3e20])
def test_numbers_are_read_as_numbers(value: float) -> None:
    assert yaml.safe_load(yaml_number(value)) == value
