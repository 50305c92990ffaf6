"""The plug-in proper: vectorised and single environment, policy and learner for Stable-Baselines3."""
