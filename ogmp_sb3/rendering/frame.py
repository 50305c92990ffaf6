"""A frame: robot, plan and ground of one environment after a control step, as plain arrays, with colours and marks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.env.view import EnvView
from ogmp_sb3.guidance.sampling import ModeCall
from ogmp_sb3.guidance.srb import POS, VEL
from ogmp_sb3.guidance.terrain import NOTHING, TOP, X0, X1, Y0, Y1

SEEN_BEHIND = 6.0  # m: ground behind the robot that stays in sight

Colour = tuple[int, int, int]

GHOST_COLOUR = (40, 120, 255)
MARK_COLOUR = (120, 114, 104)
LOW_COLOUR, LEVEL_COLOUR, HIGH_COLOUR = (130, 126, 122), (184, 178, 166), (222, 190, 138)
COLOUR_RISE = 0.4  # m above or below the track at which ground has the high or the low colour
MARK_SPACING = 0.5  # m between lines across the ground, so that motion is seen
MARK_REACH = 8.0  # m: lines are drawn this far around the robot,
MARK_HALF_WIDTH = 3.0  # m: and no longer than this to each side


@dataclass(frozen=True, kw_only=True)
class Drawable:
    """What is drawn."""

    robot: np.ndarray
    """generalised position of the robot, shape (nq,); empty where only the oracle plays"""
    ghost: np.ndarray
    """that of a robot in its nominal pose at the reference, shape (nq,)"""
    base: np.ndarray
    """position of the robot's base, or of the reference's where only the oracle plays, shape (3,), m"""
    trail: np.ndarray
    """positions of the base in the oracle's present plan, shape (knots + 1, 3), m"""
    terrain: np.ndarray
    """boxes laid so far, those far behind left out, shape (boxes, 5); see :mod:`ogmp_sb3.guidance.terrain`"""


@dataclass(frozen=True, kw_only=True)
class Frame(Drawable):
    """One control step of one environment."""

    reference: np.ndarray
    """position of the reference's base, shape (3,), m"""
    mode: str
    """the mode at the base, with its parameters"""
    time: float
    """since the episode began, s"""
    speed: float
    """horizontal speed of the base, m/s"""
    velocity: np.ndarray
    """of the base, shape (3,), m/s"""
    reference_velocity: np.ndarray
    """of the reference's base, shape (3,), m/s"""
    commanded_speed: float
    """what the mode asks for along x, m/s"""
    ground: float
    """height of the terrain under the base, m; :data:`~ogmp_sb3.guidance.terrain.NOTHING` over a gap"""
    reward: float
    """of this step"""
    deviation: float
    """weighted distance to the reference"""
    ended: str
    """the rule that ended the episode; empty while it runs"""
    reward_terms: Mapping[str, float] = field(default_factory=dict)
    """the terms of the reward"""


def join_terrain(terrains: Iterable[np.ndarray]) -> np.ndarray:
    """All boxes that there are in any of some terrains, one that grew only at its longest.

    :param terrains: each of shape (boxes, 5)
    :return: shape (n, 5)
    """
    ends: dict[tuple[float, ...], float] = {}
    for terrain in terrains:
        for box in terrain[terrain[:, TOP] > NOTHING]:
            key = (box[X0], box[Y0], box[Y1], box[TOP])
            ends[key] = max(ends.get(key, box[X1]), box[X1])
    return np.array([(x0, x1, y0, y1, top) for (x0, y0, y1, top), x1 in ends.items()]).reshape(-1, 5)


def ground_colours(terrain: np.ndarray) -> np.ndarray:
    """Colours of boxes by their height, so that steps are seen from above too.

    :param terrain: shape (boxes, 5)
    :return: shape (boxes, 3), 0 to 255
    """
    colours = np.array([LOW_COLOUR, LEVEL_COLOUR, HIGH_COLOUR], dtype=float)
    rises = [-COLOUR_RISE, 0.0, COLOUR_RISE]
    return np.stack([np.interp(terrain[:, TOP], rises, colours[:, i]) for i in range(3)], axis=1)


def ground_marks(terrain: np.ndarray, x: float) -> np.ndarray:
    """Lines across the ground around a place on the track.

    :param terrain: shape (boxes, 5)
    :param x: m along the track
    :return: start and end of each, shape (n, 2, 3), m
    """
    lines = []
    for x0, x1, y0, y1, top in terrain:
        first, last = max(x0, x - MARK_REACH), min(x1, x + MARK_REACH)
        left, right = min(y1, MARK_HALF_WIDTH), max(y0, -MARK_HALF_WIDTH)
        for i in range(int(np.ceil(first / MARK_SPACING)), int(np.floor(last / MARK_SPACING)) + 1):
            lines.append([(i * MARK_SPACING, right, top), (i * MARK_SPACING, left, top)])
    return np.array(lines).reshape(-1, 2, 3)


def drawable_of(env: BatchEnv, row: int, view: EnvView, before: Drawable | None) -> Drawable:
    """The frame of one environment as it is now.

    :param env: the environments
    :param row: which of them
    :param view: of all of them; its reference is where the ghost stands
    :param before: an earlier scene of the same episode, whose ground stays in sight; None: there is none
    """
    sim, p = env.sim, env.sim.base_qpos
    robot, ghost = np.nan_to_num(sim.qpos[row]), sim.model.qpos0.copy()
    ghost[sim.joint_qpos] = env.task.robot_config.nominal_joints
    ghost[p : p + 3], ghost[p + 3 : p + 7] = view.reference[row, POS], view.reference_quat[row]
    ground = [env.terrain[row]]
    if before is not None:
        ground.insert(0, before.terrain[before.terrain[:, X1] > robot[p] - SEEN_BEHIND])
    return Drawable(
        robot=robot,
        ghost=ghost,
        base=robot[p : p + 3],
        trail=env.plan(row)[:, POS],
        terrain=join_terrain(ground),
    )


def frame_of(env: BatchEnv, row: int, view: EnvView, before: Frame | None, reward: float, ended: str) -> Frame:
    """The frame of one environment after a control step.

    :param env: the environments
    :param row: which of them
    :param view: of all of them, in this step
    :param before: the frame before in the same episode; None: it begins
    :param reward: of the step
    :param ended: the rule that ended the episode; empty while it runs
    """
    drawable, v = drawable_of(env, row, view, before), env.sim.base_qvel
    velocity = np.nan_to_num(env.sim.qvel[row, v : v + 3])
    return Frame(
        robot=drawable.robot,
        ghost=drawable.ghost,
        base=drawable.base,
        trail=drawable.trail,
        terrain=drawable.terrain,
        reference=view.reference[row, POS],
        mode=_described(env.guide.mode_at(row, float(drawable.base[0]))),
        time=float(env.step_count[row]) * env.task.control_dt,
        speed=float(np.linalg.norm(velocity[:2])),
        velocity=velocity,
        reference_velocity=view.reference[row, VEL],
        commanded_speed=float(view.commanded_speed[row]),
        ground=float(view.ground_height[row]),
        reward=reward,
        deviation=float(view.deviation[row]),
        ended=ended,
    )


def _described(call: ModeCall) -> str:
    values = [v if isinstance(v, str) else f"{key} {v:.2f}" for key, v in call.parameters.items()]
    return " ".join([call.name, ", ".join(values)]).strip()
