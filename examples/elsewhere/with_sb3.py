"""Train the task under Stable-Baselines3: its own PPO, without a memory."""

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import ogmp_sb3

SAMPLES = 1_000_000

env = VecNormalize(VecMonitor(ogmp_sb3.make_env("parkour", num_envs=64, rho=0.4)))
network = {"log_std_init": -2.7}  # exploration noise of 0.13 rad: actions are in units of action.scale, 2 rad
model = PPO("MlpPolicy", env, n_steps=64, batch_size=1024, device="cpu", policy_kwargs=network, verbose=1)
model.learn(SAMPLES)
