"""The files of an exported policy, and the proof that they do what the policy does."""

from __future__ import annotations

import shutil
import time
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.env.agent import Actor
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.observations import CLIP
from ogmp_sb3.guidance.latent import reference_features, task_encoder
from ogmp_sb3.guidance.reference_data import reference_data
from ogmp_sb3.runs.policies import LoadedPolicy
from ogmp_sb3.runs.settings import versions
from ogmp_sb3.runs.storage import checksum, save_json

if TYPE_CHECKING:
    from ogmp_sb3.commands.export.controller import Controller

FORMAT = 1
FEATURE_NAMES = ("x - x0", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")
ACTOR, ENCODER, INFO = "policy.onnx", "encoder.onnx", "controller.json"
PARITY_STEPS = 1000
PARITY_REFERENCES = 150  # along random courses
TOLERANCE = 1e-5  # greatest difference from PyTorch


def observation_components(env: BatchEnv) -> list[dict[str, Any]]:
    """What stands where in an observation: term, name, slice, unit, and the typical size of the quantity.

    :param env: of the task
    :return: one mapping of plain data for each quantity, in the order of the observation
    """
    view, components, start = env.view(), [], 0
    for term, parameters in env.task.observations.items():
        if parameters is None:
            continue
        signal = registry.observations.get(term)(view, **parameters)
        begin = start
        for part in signal.parts_of(term):
            end = start + part.size
            scale = signal.scale[start - begin : end - begin].tolist()
            components.append(
                {"term": term, "name": part.name, "slice": [start, end], "unit": part.unit, "scale": scale}
            )
            start = end
    return components


def limit(value: float) -> float | None:
    """A limit as plain data: None where there is none."""
    return float(value) if np.isfinite(value) else None


def torque_limit(low: float, high: float) -> float | list[float | None] | None:
    """The limit of a torque: one number (or None) where it is the same both ways, else least and greatest."""
    return limit(high) if low == -high else [limit(low), limit(high)]


def guidance(task: TaskConfig) -> dict[str, Any]:
    """What the oracle's side of a controller needs beside set-points, as plain data."""
    robot = task.robot_config
    return {
        "oracle_params": task.oracle_params.get(task.oracle, {}),
        "feedback": list(task.feedback),
        "gait": {"height": task.gait.height, "cycle": task.gait.cycle},
        "srb": {"mass": robot.srb.mass, "inertia": list(robot.srb.inertia)},
        "feet": len(robot.feet),
    }


def description(loaded: LoadedPolicy, env: BatchEnv) -> dict[str, Any]:
    """The content of ``controller.json``, but for the checksums of the files beside it.

    :param env: of the policy's task
    """
    task, servos, lstm = loaded.task, env.sim.servos, loaded.policy.lstm_actor
    sees_latent = task.for_evaluation().uses_latent  # the policy, not its critic alone
    return {
        "format": FORMAT,
        "task": task.name,
        "oracle": task.oracle,
        "horizon": task.horizon,
        "rho": task.rho,
        "control_dt": task.control_dt,
        "control_rate_hz": 1.0 / task.control_dt,
        "physics_dt": task.physics_dt,
        "observation": {
            "size": env.observation_size,
            "clip": CLIP,
            "terms": {name: parameters for name, parameters in task.observations.items() if parameters is not None},
            "components": observation_components(env),
        },
        "action": {
            "joints": list(task.robot_config.joints),
            "nominal": list(task.robot_config.nominal_joints),
            "scale": task.action.scale,
            "unit": "rad",
            "formula": "joint_target = nominal + scale * action, at least low, at most high",
            "low": [limit(value) for value in servos.target_low],
            "high": [limit(value) for value in servos.target_high],
        },
        "encoder_features": list(FEATURE_NAMES) if sees_latent else None,
        "guidance": guidance(task) if sees_latent else None,
        "gains": {
            "kp": servos.kp.tolist(),
            "kd": servos.kd.tolist(),
            "torque_limit": [torque_limit(*ends) for ends in zip(servos.torque_low, servos.torque_high, strict=True)],
            "time_constant": servos.time_constant.tolist(),
        },
        "network": {"layers": lstm.num_layers, "hidden": lstm.hidden_size},
        "num_timesteps": loaded.info.get("num_timesteps"),
        "versions": {
            "training": loaded.info.get("versions"),
            "export": {**versions(), **{name: metadata.version(name) for name in ("onnx", "onnxruntime")}},
        },
        "source_sha256": checksum(loaded.files[0]),
    }


def export(loaded: LoadedPolicy, env: BatchEnv, out: Path) -> None:
    """Write models, description and example controller."""
    from ogmp_sb3.commands.export.onnx_graphs import actor_model, encoder_model

    out.mkdir(parents=True, exist_ok=True)
    models = {ACTOR: actor_model(loaded.policy)}
    encoder = task_encoder(loaded.task.for_evaluation())
    if encoder is not None:
        models[ENCODER] = encoder_model(encoder)
    for name, model in models.items():
        (out / name).write_bytes(model.SerializeToString())
    save_json(out / INFO, {**description(loaded, env), "sha256": {name: checksum(out / name) for name in models}})
    shutil.copyfile(Path(__file__).with_name("controller.py"), out / "controller.py")


def parity(loaded: LoadedPolicy, env: BatchEnv, controller: Controller) -> tuple[float, np.ndarray]:
    """Run the policy through episodes, with the exported one beside it on the same observations.

    :param env: one environment
    :return: the greatest difference of an action, and the time of each step of the controller, s
    """
    observation, actor = env.reset(), Actor(loaded, 1, env.observation_size)
    controller.reset()
    difference, seconds = 0.0, np.zeros(PARITY_STEPS)
    for k in range(PARITY_STEPS):
        action = actor.act(observation)
        began = time.perf_counter()
        exported = controller.act(observation[0])
        seconds[k] = time.perf_counter() - began
        difference = max(difference, float(np.abs(exported - action[0]).max()))
        result = env.step(action)
        observation = result.observation
        if result.terminated[0] or result.truncated[0]:
            observation = env.reset()
            actor.restart()
            controller.reset()
    return difference, seconds


def encoder_parity(loaded: LoadedPolicy, file: Path) -> float:
    """The greatest difference between latents of the task's references."""
    import onnxruntime

    encoder = task_encoder(loaded.task)
    assert encoder is not None
    data = reference_data(loaded.task, PARITY_REFERENCES, np.random.SeedSequence(0))
    expected = encoder(data.state, data.steps)
    features = reference_features(data.state).astype(np.float32)
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    inputs = ({"features": row[: steps + 1]} for row, steps in zip(features, data.steps, strict=True))
    latents = np.concatenate([session.run(["latent"], each)[0] for each in inputs])
    return float(np.abs(latents - expected).max())


def _check(what: str, difference: float) -> None:
    if not difference < TOLERANCE:
        raise ValueError(
            f"the {what} strays from PyTorch by {difference:.1e}, over {TOLERANCE:g}: nothing is exported."
        )
