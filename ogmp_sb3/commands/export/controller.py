"""Drive an exported policy without PyTorch and without ogmp_sb3: numpy and onnxruntime are all it needs.

An observation is one vector of SI units. ``controller.json`` lists its components under ``observation.components``,
each with its slice; which of these there are depends on the task::

    base_height      m      the base's origin over the ground below it; at most 2 m of depth are seen
    base_quat        1      orientation, w x y z, body to world; near (1, 0, 0, 0) at the start, never flips its sign
    joint_pos        rad    in the order of ``action.joints``
    base_linvel_b    m/s    velocity of the base's origin, in the axes of the body
    base_angvel_b    rad/s  angular velocity of the base, in the axes of the body (what a gyroscope gives)
    joint_vel        rad/s  in the order of ``action.joints``
    heading          rad    turn of the base about the vertical, to the left of the track, from -pi to pi
    gravity_b        1      direction of gravity, of length 1, in the axes of the body
    last_action      1      ``Controller.last_action``: what the policy gave in the control step before; 0 in the first
    clock_sin, clock_cos    of 2 pi k / n, k = 0 ... n - 1 control steps after an oracle was asked for n;
                            n is ``horizon``, or the length of the mode where that is null
    mode_latent      1      what ``encoder.onnx`` makes of the oracle's reference, computed once per query
    mirrored_mode_latent    the same of the reference's mirror image (y, roll and yaw, and their velocities, negated)
    commanded_speed  m/s    the heading speed that the mode asks for where the base is, as from a joystick
    height_scan      m      ground at the base's x + i * spacing (``observation.terms``) and the base's y, world axes,
                            minus the ground under the base, within -1 ... 1 m

``step`` gives joint-position targets; the robot's own loop turns them into torques
``kp * (target - position) - kd * velocity`` with ``gains``, at 1 kHz or so, and holds them for ``control_dt``. Where
``gains.time_constant`` is not 0, a first-order low-pass filter of so many seconds smooths the target first.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import onnxruntime


class Controller:
    """An exported policy, one robot.

    :param folder: what ``ogmp-export`` wrote
    :raises ValueError: if a file is missing, or is not the one that was exported
    """

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder)
        try:
            self.info = json.loads((folder / "controller.json").read_text(encoding="utf-8"))
            for name, checksum in self.info["sha256"].items():
                if hashlib.sha256((folder / name).read_bytes()).hexdigest() != checksum:
                    raise ValueError(f"{folder / name}: not the file that was exported (its checksum differs).")
            scale = np.concatenate([c["scale"] for c in self.info["observation"]["components"]])
            self._limit = self.info["observation"]["clip"] * scale
            self._nominal = np.array(self.info["action"]["nominal"])
            self._scale = float(self.info["action"]["scale"])
            self._low, self._high = (np.array(self.info["action"][end], dtype=float) for end in ("low", "high"))
            self._state_shape = (self.info["network"]["layers"], 1, self.info["network"]["hidden"])
        except OSError as error:
            raise ValueError(f"{error.filename}: not readable ({error.strerror}).") from None
        except (json.JSONDecodeError, UnicodeDecodeError, AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"{folder / 'controller.json'}: not what ogmp-export writes ({error}).") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # the network is too small for more
        self._session = onnxruntime.InferenceSession(folder / "policy.onnx", options, ["CPUExecutionProvider"])
        self.reset()

    def reset(self) -> None:
        """Forget what was; to be called before the first step of an episode."""
        self._h = self._c = np.zeros(self._state_shape, dtype=np.float32)
        self.last_action = np.zeros(len(self._nominal))

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The policy's action, shape (joints,), in [-1, 1]; keeps the network's state for the next step."""
        if np.shape(observation) != self._limit.shape:
            raise ValueError(f"an observation has shape {self._limit.shape}, found {np.shape(observation)}.")
        clipped = np.clip(observation, -self._limit, self._limit).astype(np.float32)
        inputs = {"obs": clipped[None], "h": self._h, "c": self._c}
        action, self._h, self._c = self._session.run(["action", "h_next", "c_next"], inputs)
        self.last_action = action[0]
        return action[0]  # type: ignore[no-any-return]

    def step(self, observation: np.ndarray) -> np.ndarray:
        """One control step: joint-position targets in rad, shape (joints,), in the order of ``action.joints``."""
        targets = self._nominal + self._scale * self.act(observation)
        # No limit is null in JSON, so NaN here, which these skip.
        return np.fmin(np.fmax(targets, self._low), self._high)  # type: ignore[no-any-return]
