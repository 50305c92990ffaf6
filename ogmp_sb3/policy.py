"""The former place of the policy, which models saved by Stable-Baselines3 before 0.2 name. For one release."""

from ogmp_sb3.sb3.policy import LstmPolicy, Normaliser  # noqa: F401
