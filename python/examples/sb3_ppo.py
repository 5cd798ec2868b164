"""Stable-Baselines3's PPO learns Goal Reach from pictures and vectors: sb3_ppo.py [DECISIONS].

The four variants come in turn, and the goal is told in the vector.
"""

import sys

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import covers_envs
from covers_envs.sb3 import SB3VecEnv

ENVS = 16


def success(model, episodes=64):
    """Share of episodes of another seed in which the policy succeeds."""
    env = covers_envs.make_vec("goal-reach", episodes, embodiment="hand", seed=1_000)
    observation, _ = env.reset()
    succeeded = np.zeros(episodes, bool)
    for _ in range(env.decisions):
        actions, _ = model.predict(observation, deterministic=True)
        observation, _, _, _, infos = env.step(actions)
        succeeded |= infos["success"]
    return succeeded.mean()


env = covers_envs.make_vec("goal-reach", ENVS, embodiment="hand", seed=0)
model = PPO(
    "MultiInputPolicy", VecMonitor(SB3VecEnv(env)), n_steps=100, batch_size=200, n_epochs=4,
    gamma=0.9, learning_rate=5e-4, policy_kwargs={"log_std_init": -0.5}, seed=0,
)  # fmt: skip
print(f"success before: {success(model):.2f}", flush=True)
for _ in range(5):
    model.learn(int(sys.argv[1] if len(sys.argv) > 1 else 100_000) // 5, reset_num_timesteps=False)
    print(f"success after {model.num_timesteps} decisions: {success(model):.2f}", flush=True)
