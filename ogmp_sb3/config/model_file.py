"""Where a robot's model lies: a file beside robot.yaml, in an installed package, or in MuJoCo's Menagerie."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from ogmp_sb3.config.messages import did_you_mean

PACKAGE = "package:"  # package:<name>/<path in it>
MENAGERIE = "menagerie:"  # menagerie:<robot> or menagerie:<robot>/<model>
HOW = 'pip install "ogmp_sb3[menagerie]"'


def model_file(name: str, beside: Path) -> Path:
    """The file of a model by what ``mjcf`` in robot.yaml says.

    :param name: a path; or ``package:<package>/<path>``; or ``menagerie:<robot>[/<model>]``, which is downloaded once
    :param beside: what a path is relative to
    :raises ValueError: if there is no such package, robot or model, or it cannot be downloaded
    """
    if name.startswith(PACKAGE):
        return _in_package(name)
    if name.startswith(MENAGERIE):
        return _of_menagerie(name)
    return beside / Path(name).expanduser()


def _in_package(name: str) -> Path:
    package, _, path = name.removeprefix(PACKAGE).partition("/")
    try:
        spec = importlib.util.find_spec(package) if package.isidentifier() else None
    except ImportError:
        spec = None
    if spec is None or not spec.submodule_search_locations:
        raise ValueError(f"'{name}' is in the package '{package}', which is not installed.")
    return Path(spec.submodule_search_locations[0]) / path


def _of_menagerie(name: str) -> Path:
    try:
        import mujoco_menagerie
    except ImportError:
        raise ValueError(f"'{name}' needs the package mujoco-menagerie: {HOW}.") from None
    robot, _, model = name.removeprefix(MENAGERIE).partition("/")
    known = mujoco_menagerie.names()
    if robot not in known:
        raise ValueError(f"'{name}': there is no robot '{robot}'{did_you_mean(robot, known)}")
    found = mujoco_menagerie.get(robot)
    if model and model not in found.entry_names:
        raise ValueError(f"'{name}': there is no model '{model}'{did_you_mean(model, found.entry_names)}")
    try:
        return Path(found.xml(model or found.default_model))
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise ValueError(f"'{name}': {' '.join(str(error).split())}") from None
