"""Train the task under rsl_rl: its PPO, with LSTMs. It needs ``pip install "ogmp_sb3[rsl-rl]"``."""

from rsl_rl.runners import OnPolicyRunner

import ogmp_sb3

ITERATIONS = 244  # of 64 steps of 64 environments: a million samples

env = ogmp_sb3.RslRlVecEnv("parkour", num_envs=64, rho=0.4)
lstm = {"class_name": "RNNModel", "rnn_hidden_dim": 128, "hidden_dims": [128], "obs_normalization": True}
noise = {"class_name": "GaussianDistribution", "init_std": 0.065}  # 0.13 rad: actions are in units of 2 rad
ppo = {"class_name": "PPO", "learning_rate": 3e-4, "schedule": "fixed", "gamma": 0.97, "num_mini_batches": 4}
models = {"actor": {**lstm, "distribution_cfg": noise}, "critic": lstm}
groups = {"actor": ["policy"], "critic": ["critic" if "critic" in env.get_observations().keys() else "policy"]}
settings = {"algorithm": ppo, **models, "obs_groups": groups, "num_steps_per_env": 64, "save_interval": 50}
OnPolicyRunner(env, settings, log_dir="runs/rsl_rl").learn(ITERATIONS)
