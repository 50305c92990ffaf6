"""Train the task in a loop of one's own, in the manner of CleanRL: PPO in PyTorch on a vector of Gymnasium's."""

import gymnasium
import numpy as np
import torch as th
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from torch import nn

UPDATES, STEPS, ENVS = 244, 64, 64  # a million samples
GAMMA, LAMBDA, CLIP, NOISE = 0.97, 0.95, 0.2, 0.065  # noise of 0.13 rad: actions are in units of 2 rad

env = RecordEpisodeStatistics(gymnasium.make_vec("ogmp_sb3:OGMP/Parkour-v0", ENVS, "vector_entry_point", rho=0.4))
bounds = th.as_tensor(env.single_observation_space.high)
size, scale = len(bounds), bounds / 50  # typical sizes
actor, critic = (
    nn.Sequential(nn.Linear(size, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs))
    for outputs in (env.single_action_space.shape[0], 1)
)
optimiser = th.optim.Adam([*actor.parameters(), *critic.parameters()], lr=3e-4)
observation, _ = env.reset(seed=0)
for update in range(UPDATES):
    rollout = []
    for _ in range(STEPS):
        seen = th.as_tensor(observation) / scale
        with th.no_grad():
            action = th.distributions.Normal(actor(seen), NOISE).sample()
        observation, reward, terminated, truncated, infos = env.step(action.numpy())
        after, done = observation.copy(), terminated | truncated
        if done.any():  # what was seen last; what the environment gave belongs to the next episode
            after[done] = np.stack(infos["final_obs"][done])
        step = (th.as_tensor(reward).float(), th.as_tensor(~terminated), th.as_tensor(~done))
        rollout.append((seen, action, th.as_tensor(after) / scale, *step))
    seen, action, after, reward, alive, same = map(th.stack, zip(*rollout, strict=True))
    with th.no_grad():
        value, old = critic(seen)[..., 0], th.distributions.Normal(actor(seen), NOISE).log_prob(action).sum(-1)
        error = reward + GAMMA * alive * critic(after)[..., 0] - value
        advantage = th.zeros_like(error)
        for t in reversed(range(STEPS)):
            advantage[t] = error[t] + (GAMMA * LAMBDA * same[t] * advantage[t + 1] if t + 1 < STEPS else 0)
    data = [x.flatten(0, 1) for x in (seen, action, old, advantage, advantage + value)]
    for rows in (rows for _ in range(5) for rows in th.randperm(STEPS * ENVS).split(1024)):
        seen, action, old, advantage, target = (x[rows] for x in data)
        ratio = (th.distributions.Normal(actor(seen), NOISE).log_prob(action).sum(-1) - old).exp()
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        gain = th.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
        loss = 0.5 * (critic(seen)[..., 0] - target).pow(2).mean() - gain
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], 0.5)
        optimiser.step()
    returns = env.return_queue or [float("nan")]
    print(f"{(update + 1) * STEPS * ENVS:,} samples, mean return {np.mean(returns):.1f}")
