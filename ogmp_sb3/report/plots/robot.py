"""A robot from the front and from the side, with the names of its parts."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from ogmp_sb3.env.ground_contacts import foot_bodies, touching
from ogmp_sb3.env.robot_check import nominal_data
from ogmp_sb3.env.robot_model import build_model
from ogmp_sb3.porting.anatomy import Leg
from ogmp_sb3.porting.port import PHYSICS_DT, Port
from ogmp_sb3.report.plots.style import in_style, save

VIEWS = (("side", 0), ("front", 1))  # title, horizontal axis
NEAR = 0.06  # m
LEG, FOOT, BODY = "#1f6fb4", "#d1495b", "#8d99ae"


@in_style
def draw_robot(port: Port, path: Path) -> Path:
    """Draw the nominal pose as it is simulated: what can touch the ground, and the joints with their names.

    :return: the path
    """
    robot = port.robot
    model = build_model(robot, PHYSICS_DT, 1)
    data = nominal_data(robot, model)
    mujoco.mj_comPos(model, data)
    feet = foot_bodies(model, robot)
    figure = Figure(figsize=(12, 7), layout="constrained")
    own = model.body_rootid[model.geom_bodyid] == model.body(robot.base).id
    for axes, (title, across) in zip(figure.subplots(1, 2), VIEWS, strict=True):
        for geom in np.flatnonzero(own & touching(model)).tolist():
            corners = _corners(model, data, geom)[:, [across, 2]]
            colour = FOOT if model.geom_bodyid[geom] in feet else BODY
            axes.fill(*_hull(corners).T, facecolor=colour, alpha=0.25, edgecolor=colour, linewidth=0.8)
        for leg in _seen(port.anatomy.legs, data, model, title):
            ids = [model.joint(name).id for name in leg.joints]
            points = np.vstack([data.xanchor[ids], data.xpos[model.body(leg.foot).id]])[:, [across, 2]]
            axes.plot(*points.T, "o-", color=LEG, markersize=4, linewidth=1.5)
            for names, point in _labels([*leg.joints, leg.foot], points):
                axes.annotate(names, point, xytext=(7, 0), textcoords="offset points", fontsize=6, va="center")
        centre = data.subtree_com[model.body(robot.base).id]
        axes.plot(centre[across], centre[2], "k+", markersize=10)
        axes.annotate(
            "centre of mass", (centre[across], centre[2]), xytext=(8, 6), textcoords="offset points", fontsize=7
        )
        axes.axhline(0.0, color="black", linewidth=1.0)
        axes.set(title=f"{robot.name}, from the {title}", xlabel="xy"[across] + " (m)", ylabel="z (m)")
        axes.set_aspect("equal", adjustable="datalim")
    save(figure, path)
    return path


def _seen(legs: tuple[Leg, ...], data: mujoco.MjData, model: mujoco.MjModel, title: str) -> list[Leg]:
    """The legs that hide no other: from the side the left ones, from the front those that are farthest ahead."""
    place = {leg.foot: data.xpos[model.body(leg.foot).id] for leg in legs}
    if title == "side":
        return [leg for leg in legs if place[leg.foot][1] >= max(y for _, y, _ in place.values()) - NEAR]
    return [leg for leg in legs if place[leg.foot][0] >= max(x for x, _, _ in place.values()) - NEAR]


def _labels(names: list[str], points: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Names, one below the other where their points nearly coincide."""
    labels: list[tuple[str, np.ndarray]] = []
    for name, point in zip(names, points, strict=True):
        if labels and np.linalg.norm(labels[-1][1] - point) < NEAR:
            labels[-1] = (f"{labels[-1][0]}\n{name}", labels[-1][1])
        else:
            labels.append((name, point))
    return labels


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Corners of the box around a geom, world frame, shape (8, 3), m."""
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    local = model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]
    corners: np.ndarray = data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T
    return corners


def _hull(points: np.ndarray) -> np.ndarray:
    """The corners of the convex hull of points of a plane, in order."""
    try:
        return points[ConvexHull(points).vertices]  # type: ignore[no-any-return]
    except QhullError:  # on a line
        return points
