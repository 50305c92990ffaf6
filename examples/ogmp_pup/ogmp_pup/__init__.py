"""Pup, a made-up quadruped for ogmp_sb3: robot, task, mode, oracle and terms. Importing this registers them."""

from ogmp_pup import modes, observations, oracles, rewards, terminations  # noqa: F401
