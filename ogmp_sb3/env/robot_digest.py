"""Whether two robots are the same: what of a compiled model and of robot.yaml bears on a simulation."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.env.robot_spec import read_mjcf

PHYSICS_DT = 0.002  # s; the task's takes its place in a simulation
NAMED = ("name", "mjcf", "source", "path")  # entries of robot.yaml that change nothing
TINY = 1e-12  # what is smaller is rounding
# Names, and what is only seen; meshes and height fields are compared where a geom has their shape.
_SEEN = re.compile(
    r"(tex|mat|light|cam|skin|key|text|tuple|name|names|bvh|oct|mesh|hfield)_.*|.*_(rgba|matid|user|bvhadr|bvhnum)"
    r"|(geom|site|jnt|tendon|flex)_group|(geom|site)_dataid|tendon_width|flex_.*texcoord.*"
)
_DERIVED = re.compile(r"efm.*|.*_(acc0|length0|invweight0|M0|subtreemass|rbound|aabb|sameframe)")  # from the others


def robot_digest(robot: RobotConfig) -> str:
    """Identifies what a robot is in a simulation, whatever its files are called and wherever they lie.

    It is of what MuJoCo and this package make of the files, so it is the same for the same versions of both. Numbers
    count to single precision, which spares it the last bits that differ between processors.

    :raises ValueError: if the robot cannot be compiled
    """
    sum_ = hashlib.sha256()
    for name, value in sorted(_parts(robot).items()):
        is_array = isinstance(value, np.ndarray)
        sum_.update(
            f"{name} {value.dtype.str} {value.shape}\n".encode() if is_array else f"{name} {value!r}\n".encode()
        )
        sum_.update(value.tobytes() if is_array else b"")
    return sum_.hexdigest()[:16]


def robot_changes(before: RobotConfig, after: RobotConfig) -> list[str]:
    """In what two robots differ: keys of robot.yaml, then arrays of the compiled model.

    :raises ValueError: if one of them cannot be compiled
    """
    one, other = _parts(before), _parts(after)
    keys = [name for name in one if name not in other or not _same(one[name], other[name])]
    return keys + [name for name in other if name not in one]


def same_model(one: Path, other: Path) -> bool:
    """Whether two MJCF files compile to the same model, bit for bit, names and all that is only seen included.

    :raises ValueError: if one of them cannot be compiled
    """
    models = [read_mjcf(path).compile() for path in (one, other)]
    first, second = ({**_arrays(model), "names": model.names} for model in models)
    return all(name.endswith("_pathadr") or _same(value, second[name]) for name, value in first.items())


def _parts(robot: RobotConfig) -> dict[str, Any]:
    """What of a robot bears on a simulation, by the name of the key or of the array."""
    said = {key: value for key, value in dataclasses.asdict(robot).items() if key not in NAMED}
    model = build_model(robot, PHYSICS_DT, 0)
    arrays = {**_arrays(model), **_options(model.opt), "stat.meaninertia": np.array(model.stat.meaninertia)}
    kept = {name: value for name, value in arrays.items() if not (_SEEN.fullmatch(name) or _DERIVED.fullmatch(name))}
    # The names in robot.yaml mean elements of the model: two that change their names change places.
    places = {
        "base and feet": _ids(model, mujoco.mjtObj.mjOBJ_BODY, (robot.base, *robot.feet)),
        "places of the joints": _ids(model, mujoco.mjtObj.mjOBJ_JOINT, robot.joints),
        "places of the actuators": _ids(model, mujoco.mjtObj.mjOBJ_ACTUATOR, robot.joints),
    }
    return {**said, **{name: _rounded(value) for name, value in {**kept, **_shapes(model), **places}.items()}}


def _arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    values = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _options(option: mujoco.MjOption) -> dict[str, np.ndarray]:
    return {f"option.{name}": np.array(getattr(option, name)) for name in dir(option) if not name.startswith("_")}


def _shapes(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The meshes and height fields that geoms have the shape of."""
    shapes = {}
    for geom in range(model.ngeom):
        kind, data = model.geom_type[geom], model.geom_dataid[geom]
        if data < 0:
            continue
        if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            begin, size = model.hfield_adr[data], model.hfield_nrow[data] * model.hfield_ncol[data]
            parts = [model.hfield_size[data], [model.hfield_nrow[data]], model.hfield_data[begin : begin + size]]
        else:
            begin, face = model.mesh_vertadr[data], model.mesh_faceadr[data]
            vertices = model.mesh_vert[begin : begin + model.mesh_vertnum[data]]
            faces = model.mesh_face[face : face + model.mesh_facenum[data]]
            parts = [vertices.ravel(), faces.ravel(), _hull(model, data)]
        shapes[f"shape of geom {model.geom(geom).name or geom}"] = np.concatenate(parts)
    return shapes


def _hull(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """The vertices of a mesh's convex hull, which is what collides; none if it has none."""
    begin = model.mesh_graphadr[mesh]
    if begin < 0:
        return np.zeros(0)
    count = model.mesh_graph[begin]
    return model.mesh_graph[begin + 2 + count : begin + 2 + 2 * count]  # type: ignore[no-any-return]


def _ids(model: mujoco.MjModel, kind: mujoco.mjtObj, names: tuple[str, ...]) -> np.ndarray:
    return np.array([mujoco.mj_name2id(model, kind, name) for name in names])


def _rounded(values: np.ndarray) -> np.ndarray:
    """Numbers to single precision; what is all but 0 is 0, whatever its sign."""
    if values.dtype.kind != "f":
        return values
    return np.where(np.abs(values) < TINY, 0.0, values).astype(np.float32)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return bool(one == other)
