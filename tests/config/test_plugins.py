"""Plug-ins: found through their entry points, loaded when needed, and clear about what is wrong with them.

Small ones are laid on ``sys.path`` by hand, with the metadata that pip would write; the example is really installed.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from jsonschema import Draft202012Validator

import ogmp_sb3
from helpers.paths import ROOT
from helpers.plugins import lay
from helpers.programs import script
from ogmp_sb3.config import plugins, registry
from ogmp_sb3.config.catalogue import PACKAGE, find, names
from ogmp_sb3.config.editor_schema import task_schema
from ogmp_sb3.config.load import load_robot, load_task
from ogmp_sb3.config.plugins import NameTaken
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.scenes import task_for_test
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.guidance.latent import load_encoder
from ogmp_sb3.guidance.modes import Contact
from ogmp_sb3.guidance.oracles import Plant
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.set_points import SetPoints
from ogmp_sb3.guidance.srb import POS, VEL
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.settings import versions

EXAMPLE = ROOT / "examples" / "ogmp_pup"
STAIRS = find("task", "stairs").read_text(encoding="utf-8")
SKIP = """
from ogmp_sb3.guidance.modes import Segment, Span
from ogmp_sb3.config.registry import modes

@modes.register()
def {name}(v: float) -> Segment:
    return Segment(length=1.0, spans=(Span(end=1.0, velocity=(v, 0.0)),))
"""


Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forget: None) -> Install:
    """Lay a package on ``sys.path``, with the metadata of an installed distribution of version 1.2."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(name: str, files: dict[str, str], entry: str = "") -> Path:
        return lay(tmp_path, name, files, entry)

    return install


def task_of(*modes: str) -> str:
    """A task file that names modes: stairs with one more."""
    data = yaml.safe_load(STAIRS)
    data["modes"] |= {mode: {"v": 0.5} for mode in modes}
    return yaml.safe_dump(data)


# ---- found when needed ----


def test_a_task_that_names_only_what_ships_never_loads_a_plugin(install: Install) -> None:
    install("plug_a", {"__init__.py": "raise RuntimeError('loaded')"})
    for name in ("parkour", "dive", "stairs"):
        load_task(name)
    assert plugins._plugins is None
    assert plugins.loaded_plugins() == []


def test_modes_tasks_and_robots_of_a_plugin_are_found_by_name(install: Install) -> None:
    hector = load_robot("hector")
    robot = hector.path.read_text().replace("hector.xml", str(hector.mjcf_path.resolve()))
    folder = install(
        "plug_a",
        {
            "__init__.py": "from plug_a import modes",
            "modes.py": SKIP.format(name="skip"),
            "tasks/skipping.yaml": task_of("skip").replace("hector", "hectar"),
            "robots/hectar/robot.yaml": robot,
        },
    )
    task = load_task("skipping", {"modes.skip.v": [0.2, 0.4]})
    assert task.name == "skipping"
    assert task.mode_ranges["skip"]["v"].high == 0.4
    assert task.robot_config.path == folder / "robots" / "hectar" / "robot.yaml"
    assert {"skipping", "parkour"} <= set(names("task"))
    assert ModeCall("skip", {"v": 0.5}).segment().length == 1.0
    assert BatchEnv(task).step(np.zeros((1, 10))).reward.shape == (1,)
    assert [plugin.folder for plugin in plugins.loaded_plugins()] == [folder]
    assert versions()["plug_a"] == "1.2"


def test_scenes_encoders_and_policies_of_a_plugin_are_found_by_name(
    install: Install,
) -> None:
    folder = install(
        "plug_a",
        {"__init__.py": SKIP.format(name="skip"), "tasks/scenes/slower.yaml": find("scene", "faster").read_text()},
    )
    for kind in ("encoders", "policies"):
        shutil.copytree(PACKAGE / kind / "dive", folder / kind / "diving")
    assert find("scene", "slower") == folder / "tasks" / "scenes" / "slower.yaml"
    task = task_for_test(read_yaml(find("task", "parkour")), find("task", "parkour"), [], "slower", "test")
    assert task.sampling.order == "sequence"
    states, steps = np.zeros((1, 4, 12)), np.array([3])
    np.testing.assert_array_equal(load_encoder("diving")(states, steps), load_encoder("dive")(states, steps))
    assert load_policy("diving").path == folder / "policies" / "diving"
    assert {"dive", "diving"} <= set(names("encoder")) & set(names("policy"))
    assert names("task") == ["dive", "dive_robot", "parkour", "parkour_robot", "stairs"]


def test_the_entry_point_may_name_a_module_inside_the_package(install: Install) -> None:
    files = {"__init__.py": "", "terms.py": SKIP.format(name="skip"), "tasks/skipping.yaml": task_of("skip")}
    folder = install("plug_a", files, entry="plug_a.terms")
    assert find("task", "skipping") == folder / "tasks" / "skipping.yaml"
    load_task("skipping")


def test_a_single_file_may_register_but_brings_no_folders(install: Install, tmp_path: Path) -> None:
    """Else any package called ``tasks`` would count as its own."""
    install("plug_a", {}, entry="plug_single")
    (tmp_path / "plug_single.py").write_text(SKIP.format(name="skip"))
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "stray.yaml").write_text(STAIRS)
    assert "skip" in registry.modes.names()
    assert "stray" not in names("task")


def test_a_plugin_may_look_names_up_while_it_is_imported(install: Install) -> None:
    install("plug_a", {"__init__.py": SKIP.format(name="skip") + "assert 'pace' in modes.names()"})
    install("plug_b", {"__init__.py": SKIP.format(name="hobble")})
    assert {"skip", "hobble", "pace"} <= set(registry.modes.names())


# ---- broken ones ----


@pytest.fixture
def broken(install: Install) -> None:
    """A plug-in that registers ``limp`` and then fails, beside one that works."""
    files = {"__init__.py": SKIP.format(name="limp") + "import no_such_module", "tasks/limping.yaml": task_of("limp")}
    install("plug_broken", files)
    install("plug_sound", {"__init__.py": SKIP.format(name="skip"), "tasks/skipping.yaml": task_of("skip")})


REASON = (
    "And plug-in 'of_plug_broken' of plug_broken 1.2 is broken "
    r"\(ModuleNotFoundError: No module named 'no_such_module'\)\."
)


def test_a_broken_plugin_is_named_where_a_name_is_unknown(broken: None, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(task_of("limp"))
    with pytest.raises(KeyError, match=rf"mine.yaml: 'modes': unknown mode 'limp' \(allowed: .* {REASON}"):
        load_task(path)
    with pytest.raises(KeyError, match=rf"unknown task 'limping' \(allowed: .* {REASON}"):
        load_task("limping")
    with pytest.raises(KeyError, match=rf"unknown robot 'hectr' .* {REASON}"):
        load_robot("hectr")


def test_a_broken_plugin_breaks_nobody_else(broken: None) -> None:
    load_task("parkour")
    assert load_task("skipping").name == "skipping"
    assert [plugin.name for plugin in plugins.loaded_plugins()] == ["of_plug_sound"]
    assert "plug_broken" not in versions()


def test_a_broken_plugin_leaves_nothing_behind(broken: None) -> None:
    assert "limp" not in registry.modes.names()
    assert "limping" not in names("task")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("from ogmp_sb3.registry import modes", "No module named 'ogmp_sb3.registry'"),
        ("from ogmp_sb3.guidance.modes import jump_up", "cannot import name 'jump_up' from 'ogmp_sb3.guidance.modes'"),
    ],
)
def test_a_plugin_that_misses_a_module_of_ours_is_told_where_to_import_from(
    install: Install, line: str, said: str
) -> None:
    install("plug_old", {"__init__.py": line})
    with pytest.raises(KeyError, match=rf"is broken \(\w+: {said}.*; import from ogmp_sb3\.extend\)\."):
        registry.modes.get("skip")


@pytest.mark.parametrize("entry", ["plug_a:VALUE", "plug_empty"])
def test_an_entry_point_must_name_a_module(install: Install, tmp_path: Path, entry: str) -> None:
    install("plug_a", {"__init__.py": "VALUE = 3"}, entry=entry)
    (tmp_path / "plug_empty").mkdir()
    with pytest.raises(KeyError, match=f"broken .TypeError: '{entry}' must name a module, or a package with an __init"):
        registry.modes.get("skip")


# ---- names that are taken ----


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"__init__.py": SKIP.format(name="jump")},
            "mode 'jump' of plug_b is registered already, by ogmp_sb3.guidance.modes",
        ),
        ({"__init__.py": SKIP.format(name="skip")}, "mode 'skip' of plug_b is registered already, by plug_a"),
        ({"__init__.py": "", "tasks/dive.yaml": STAIRS}, r"plug_b/tasks/dive\.yaml .* of .*ogmp_sb3/tasks/dive"),
        ({"__init__.py": "", "tasks/skipping.yaml": ""}, r"plug_b/tasks/skipping\.yaml .* of .*plug_a/tasks"),
        ({"__init__.py": "", "robots/hector/robot.yaml": ""}, r"plug_b/robots/.* of .*ogmp_sb3/robots"),
        ({"__init__.py": "", "tasks/scenes/faster.yaml": ""}, r"plug_b/tasks/scenes/.* of .*ogmp_sb3/tasks/scenes"),
        ({"__init__.py": "", "encoders/dive/encoder.json": ""}, r"plug_b/encoders/.* of .*ogmp_sb3/encoders"),
        ({"__init__.py": "", "policies/dive/policy.json": ""}, r"plug_b/policies/.* of .*ogmp_sb3/policies"),
    ],
)
def test_a_name_clash_is_an_error_that_names_both(install: Install, files: dict[str, str], message: str) -> None:
    install("plug_a", {"__init__.py": SKIP.format(name="skip"), "tasks/skipping.yaml": task_of("skip")})
    install("plug_b", files)
    load_task("parkour")
    for _ in range(2):  # it stays one
        with pytest.raises(NameTaken, match=f"^plug-in 'of_plug_b' of plug_b 1.2: .*{message}"):
            load_task("skipping")
    with pytest.raises(NameTaken, match=message):
        registry.modes.names()


# ---- the example, really installed ----


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pip put the example."""
    folder = tmp_path_factory.mktemp("example")
    source, target = folder / "source", folder / "target"  # a build leaves files beside the sources
    shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation", "--no-index", "--target"]
    done = subprocess.run([*command, str(target), str(source)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return target


@pytest.fixture
def pup(target: Path, monkeypatch: pytest.MonkeyPatch, forget: None) -> RobotConfig:
    """The example's robot, the example being installed in this process."""
    monkeypatch.syspath_prepend(target)
    importlib.invalidate_caches()
    return load_robot("pup")


def test_the_example_s_robot_stands_for_a_second_under_its_servos_alone(pup: RobotConfig) -> None:
    env = BatchEnv(load_task("hurdles", {"rho": None}))
    env.reset()
    for _ in range(34):
        result = env.step(np.zeros((1, 12)))
    assert not result.terminated[0]
    assert not result.view.body_contact[0]
    assert result.view.base_pos_w[0, 2] == pytest.approx(pup.nominal_height, abs=0.02)
    np.testing.assert_allclose(result.view.base_quat[0], [1, 0, 0, 0], atol=0.01)
    np.testing.assert_allclose(result.view.joint_pos[0], pup.nominal_joints, atol=0.1)
    assert np.abs(result.view.joint_vel).max() < 0.05
    assert np.abs(result.view.torque).max() < 5.0  # N m, of 15


def test_the_example_s_srb_is_the_sum_over_its_bodies(pup: RobotConfig) -> None:
    model = build_model(pup, 0.002, 1)
    data = mujoco.MjData(model)
    for name, angle in zip(pup.joints, pup.nominal_joints, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    base = model.body(pup.base).id
    assert pup.srb.mass == pytest.approx(model.body_subtreemass[base], rel=1e-6)
    inertia = np.zeros((3, 3))
    for body in range(base, model.nbody):
        offset, axes = data.xipos[body] - data.subtree_com[base], data.ximat[body].reshape(3, 3)
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += model.body_mass[body] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    np.testing.assert_allclose(pup.srb.inertia, np.diag(inertia), rtol=1e-5)


def test_every_body_of_the_example_that_meets_the_terrain_feels_it(pup: RobotConfig) -> None:
    model = build_model(pup, 0.002, 1)
    robot = model.geom_bodyid > 0
    assert not model.geom_contype[robot].any()  # no robot geom meets another
    meets = {model.body(i).name for i in model.geom_bodyid[robot & (model.geom_conaffinity > 0)]}
    assert {model.sensor(i).name.removesuffix("_contact") for i in range(model.nsensor)} == meets
    assert set(pup.feet) <= meets


def test_pictures_of_the_example_show_more_than_its_physics_and_weigh_the_same(pup: RobotConfig) -> None:
    plain, seen = (build_model(pup, 0.002, 1, visual=visual) for visual in (False, True))
    assert seen.ngeom > plain.ngeom
    np.testing.assert_array_equal(seen.body_mass, plain.body_mass)


def test_the_example_s_mode_flies_over_the_bar_with_the_whole_body(pup: RobotConfig) -> None:
    segment = ModeCall("hurdle", {"h": 0.05, "v": 1.2, "run_up": 0.6}).segment()
    before, flight, after = segment.spans[1], segment.spans[2], segment.spans[3]
    bar = segment.plateaus[1]
    assert (flight.contact, bar.top) == (Contact.FLIGHT, 0.05)
    model = build_model(pup, 0.002, 1)
    front, rear = (model.body(f"{name}_hip").pos[0] for name in ("FL", "RL"))
    assert before.end + front < bar.start  # the front feet leave before the bar
    assert flight.end + rear > bar.end  # and the rear ones land behind it
    assert flight.end < after.end == segment.length
    half = 0.5 * (flight.end - before.end) / 1.2
    assert flight.apex == pytest.approx(0.5 * 0.5 * 9.81 * half**2 * 2)


def test_the_example_s_oracle_lets_the_offset_fade_and_ends_on_the_set_points(pup: RobotConfig) -> None:
    points = SetPoints(np.zeros((2, 31, 12)), np.ones((2, 30), bool), np.zeros((2, 30), int), np.full(2, 30), 1.0)
    points.state[..., POS] = np.linspace([0, 0, 0.25], [1, 0, 0.25], 31)
    x0 = np.random.default_rng(0).normal(size=(2, 12))
    reference = registry.oracles.get("fade")(points, x0, Plant(pup.srb, 0.03), time_constant=0.06).state
    np.testing.assert_array_equal(reference[:, 0], x0)
    offset = reference[..., POS] - points.state[..., POS]
    np.testing.assert_allclose(offset[:, 2::2], offset[:, :-1:2] / np.e, atol=1e-12)
    np.testing.assert_allclose(reference[:, -1, POS], points.state[:, -1, POS], atol=1e-5)
    np.testing.assert_allclose(reference[:, 1:, VEL] * 0.03, np.diff(reference[..., POS], axis=1), atol=1e-12)


def test_the_example_s_reward_falls_with_the_speed_of_the_joints(pup: RobotConfig) -> None:
    env = BatchEnv(load_task("hurdles"), num_envs=2)
    calm, view = registry.rewards.get("calm"), env.view()
    fast = dataclasses.replace(view, joint_vel=np.array([np.zeros(12), np.full(12, 10 / np.sqrt(12))]))
    np.testing.assert_allclose(calm(fast, weight=0.5, sharpness=0.1), [0.5, 0.5 * np.exp(-1)])


def test_the_example_s_terms_tell_where_down_is_and_how_far_the_trunk_leans(pup: RobotConfig) -> None:
    view = BatchEnv(load_task("hurdles"), num_envs=3).view()
    lying, leaning = [np.sqrt(0.5), np.sqrt(0.5), 0, 0], [np.cos(0.5), 0, np.sin(0.5), 0]
    view = dataclasses.replace(view, base_quat=np.array([[1, 0, 0, 0], lying, leaning], dtype=float))
    down = registry.observations.get("gravity_direction")(view).value
    np.testing.assert_allclose(down, [[0, 0, -1], [0, -1, 0], [np.sin(1), 0, -np.cos(1)]], atol=1e-12)
    assert registry.terminations.get("tipped")(view, max_tilt=1.2).tolist() == [False, True, False]
    assert registry.terminations.get("tipped")(view, max_tilt=0.9).tolist() == [False, True, True]


def test_the_schema_for_editors_knows_what_the_example_brings(pup: RobotConfig) -> None:
    data = read_yaml(find("task", "hurdles"))
    validator = Draft202012Validator(task_schema())
    validator.validate(data)
    data["modes"]["hurdle"]["hight"] = 0.1
    assert not validator.is_valid(data)


COMMANDS = """
import importlib
import json
import sys
import ogmp_sb3
assert "ogmp_pup" not in sys.modules
modules = json.loads(sys.argv[1])
small = "num_envs=8 ppo.n_steps=16 ppo.batch_size=64 torch_threads=1 physics_threads=1 hydra.run.dir=run".split()
for program, arguments in (
    ("check", ["task=hurdles"]),
    ("train", ["task=hurdles", "oracle=fade", "total_timesteps=256", *small]),
    ("eval", ["run=run", "episodes=2", "evaluation.episode_steps=10"]),
    ("encode", ["task=hurdles", "references=10", "updates=10"]),
    ("export", ["run=run", "out=exported"]),
):
    sys.argv = [program, *arguments]
    importlib.import_module(modules[program]).main()
"""


def test_every_command_finds_the_installed_example(target: Path, tmp_path: Path) -> None:
    modules = {name: script(f"ogmp-{name}") for name in ("check", "train", "eval", "encode", "export")}
    path = os.pathsep.join([str(target), str(Path(ogmp_sb3.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(modules)],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "ogmp-pup 0.1.0" in done.stdout  # ogmp-check lists it
    assert "Trained to step 256" in done.stdout
    config = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())
    assert config["versions"]["ogmp-pup"] == "0.1.0"
    assert (tmp_path / "run" / "evaluation" / "metrics.json").is_file()
    assert (tmp_path / "encoders" / "hurdles" / "encoder.json").is_file()
    terms = json.loads((tmp_path / "exported" / "controller.json").read_text())["observation"]["terms"]
    assert "gravity_direction" in terms
