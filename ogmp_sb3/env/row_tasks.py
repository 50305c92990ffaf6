"""Tasks that one batch of environments plays side by side: they differ only in what is drawn for an episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

from ogmp_sb3.config.task import TaskConfig

DRAWN = ("modes", "sampling", "randomisation")  # keys of the task file


def common_task(tasks: Sequence[TaskConfig]) -> TaskConfig:
    """What tasks have in common, with room for the terrain of each.

    :return: the first of them, with as many ``track.boxes`` as any has
    :raises ValueError: if they differ in anything but what is drawn, and that room
    """
    boxes = max(task.track.boxes for task in tasks)
    common = replace(tasks[0], track=replace(tasks[0].track, boxes=boxes))
    for task in {id(task): task for task in tasks}.values():
        roomy = replace(task, track=replace(task.track, boxes=boxes))
        for field in fields(TaskConfig):
            if field.name not in DRAWN and getattr(roomy, field.name) != getattr(common, field.name):
                raise ValueError(
                    f"tasks that are played together may differ in {', '.join(DRAWN)} and track.boxes alone; found "
                    f"different {field.name}."
                )
    return common
