"""A task as a policy is tested on it: with the user's changes, and with a scene's modes in place of drawn ones."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ogmp_sb3.config.catalogue import find, shown_path
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.messages import Where
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.task import SequenceEntry, TaskConfig
from ogmp_sb3.config.yaml_files import apply_overrides, read_value, read_yaml, resolved

TRAINING_ONLY = {
    "rho": "none",
    "curriculum": "none",
    "restarts": "none",
    "min_step_reward": "none",
    "physics_dt": "evaluation.physics_dt",
    "episode_steps": "evaluation.episode_steps",
    "track.length": "evaluation.track_length",
    "terminations": "evaluation.terminations",
    "initial": "evaluation.initial",
    "randomisation": "evaluation.randomisation",
}
"""Keys of a task file that a test does not use, and what it has instead."""
SHOWN = ("rho", "track.length")
"""Those of them that a play or a picture uses."""


def task_for_test(
    data: dict[str, Any], path: Path, overrides: list[str], scene: str | None, program: str, used: Iterable[str] = ()
) -> TaskConfig:
    """A task, as in training, with the changes that are wanted for a test.

    :param data: of the task as it was in training
    :param path: of the task file, for messages
    :param overrides: ``key=value``
    :param scene: a shipped scene (``"pace_to_jump"``), one of a plug-in, or the path of a YAML file;
        None: the task's own modes
    :param program: for messages
    :param used: keys for training that this test uses
    :raises KeyError: for an unknown scene or key
    :raises ValueError: for a file that cannot be read, or an override that would change nothing
    """
    data = apply_overrides(copy.deepcopy(data), overrides, program)
    training_only = dict(TRAINING_ONLY)
    if (data.get("evaluation") or {}).get("physics_dt") is None:
        del training_only["physics_dt"]  # the test has that of the training
    for override in overrides:
        key, _, text = override.partition("=")
        leaves = {".".join(leaf) for leaf in _leaves([key], read_value(text))}
        for name in ({key, key.partition(".")[0]} | leaves) & training_only.keys() - set(used):
            raise ValueError(f"{program}: '{name}' is for training alone; a test has {training_only[name]}.")
    if scene is not None:
        _apply_scene(data, scene, overrides)
    return task_from_data(resolved(data, Where(shown_path(path))), path)


def _apply_scene(data: dict[str, Any], name_or_path: str, overrides: list[str]) -> None:
    """Put a scene into plain task data: its sequence of modes is what is drawn."""
    path = find("scene", name_or_path)
    data_of_scene = resolved(read_yaml(path), Where(shown_path(path)))
    scene = read(Scene, data_of_scene, Where(shown_path(path)))
    for override in overrides:
        key, _, text = override.partition("=")
        for kind, *names in _leaves(key.split("."), read_value(text)):
            hidden = (
                kind == "modes"
                and len(names) == 2
                and all(entry.mode != names[0] or names[1] in entry.ranges for entry in scene.sequence)
            )
            if hidden or kind == "sampling":
                raise ValueError(f"'{override}' has no effect in the scene '{name_or_path}', which says that itself.")
    data["sampling"] = {"order": "sequence", "sequence": data_of_scene["sequence"], "repeat": "last"}
    data["curriculum"] = None


def _leaves(key: list[str], value: Any) -> Iterator[list[str]]:
    """The keys that a value sets, which may be a mapping of mappings."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves([*key, str(name)], inner)
    else:
        yield key


@dataclass(frozen=True, kw_only=True)
class Scene:
    """``tasks/scenes/<name>.yaml``: modes that a policy is commanded to, one after another."""

    description: str
    """one sentence"""
    sequence: tuple[SequenceEntry, ...]
    """the modes in order; the last one goes on"""
