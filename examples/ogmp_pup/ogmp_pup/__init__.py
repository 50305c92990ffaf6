"""Pup, a made-up quadruped for ogmp_sb3: a robot, a task, a mode and a reward. Importing registers them."""

from ogmp_pup import modes, rewards  # noqa: F401
