"""Tasks as they are tested: changes that would change nothing are refused."""

from __future__ import annotations

import re

import pytest

from ogmp_sb3.config.catalogue import TASKS_DIR, find
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.config.scenes import TRAINING_ONLY, task_for_test
from ogmp_sb3.config.yaml_files import read_yaml

PATH = TASKS_DIR / "parkour.yaml"


def parkour(*overrides: str, scene: str | None = None, used: tuple[str, ...] = ()):
    return task_for_test(read_yaml(PATH), PATH, list(overrides), scene, "test", used)


def test_a_scene_is_played_with_the_changes_that_it_leaves_room_for() -> None:
    task = parkour("oracle=lqr", "modes.jump.run_up=0.5", scene="pace_to_jump")
    assert (task.sampling.sequence[1].mode, task.sampling.sequence[1].ranges["h"]) == ("jump", Range(0.1, 0.1))
    assert (task.oracle, task.curriculum, task.mode_ranges["jump"]["run_up"].low) == ("lqr", None, 0.5)


@pytest.mark.parametrize(
    "override", ["modes.jump.h=0.3", "modes.leap.w=0.3", "modes.jump={h: 0.3}", "sampling.order=random"]
)
def test_a_change_that_a_scene_hides_is_refused(override: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"'{override}' has no effect in the scene 'pace_to_jump'")):
        parkour(override, scene="pace_to_jump")


@pytest.mark.parametrize("key", TRAINING_ONLY)
def test_keys_for_training_alone_are_refused(key: str) -> None:
    with pytest.raises(ValueError, match=f"^test: '{key}' is for training alone; a test has "):
        parkour(f"{key}=null")


def test_a_key_for_training_alone_is_refused_within_a_mapping_too() -> None:
    with pytest.raises(ValueError, match=r"^test: 'track.length' is for training alone"):
        parkour("track={width: 3.0, length: 20.0}")
    assert parkour("track={width: 3.0}").track.width == 3.0


def test_a_test_of_robustness_uses_the_disturbances_of_the_training() -> None:
    assert parkour("randomisation.mass.scale=1.2", used=("randomisation",)).randomised["mass"]["scale"] == Range(
        1.2, 1.2
    )


def test_a_scene_of_one_s_own_is_read_from_its_file(tmp_path) -> None:
    scene = find("scene", "faster").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(scene, encoding="utf-8")
    assert parkour(scene=str(tmp_path / "mine.yaml")).sampling == parkour(scene="faster").sampling


def test_a_physics_step_of_the_training_counts_in_a_test_that_has_none_of_its_own() -> None:
    data = read_yaml(PATH)
    data["evaluation"]["physics_dt"] = None
    task = task_for_test(data, PATH, ["physics_dt=0.001"], None, "test")
    assert task.for_evaluation().physics_dt == 0.001
