"""The plug-in proper: environments, policy and learner for Stable-Baselines3."""
