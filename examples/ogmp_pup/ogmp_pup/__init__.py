"""Pup, a made-up quadruped for ogmp_sb3: robot, task, mode, oracle and reward. Importing this registers them."""

from ogmp_pup import modes, oracles, rewards  # noqa: F401
