"""Stable-Baselines3's PPO learns Goal Reach, all four variants of it: sb3_ppo.py [DECISIONS] [PART].

PART of the observation is `vector` (default), which tells the goal, or `all`, with the pictures.
"""

import sys

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import covers_envs
from covers_envs.sb3 import SB3VecEnv

DECISIONS = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
PART = None if sys.argv[2:] == ["all"] else "vector"


def make(num_envs, seed):
    env = covers_envs.make_vec("goal-reach", num_envs, embodiment="hand", seed=seed, autoreset_mode="SameStep")
    return SB3VecEnv(env, only=PART)


def success(model, episodes=64):
    """Share of episodes of another seed in which the policy succeeds."""
    env = make(episodes, seed=1000)
    observation, succeeded = env.reset(), np.zeros(episodes, bool)
    for _ in range(env.env.decisions):
        actions, _ = model.predict(observation, deterministic=True)
        observation, _, _, infos = env.step(actions)
        succeeded |= [info["is_success"] for info in infos]
    return succeeded.mean()


policy = "MlpPolicy" if PART else "MultiInputPolicy"
settings = {"n_steps": 100, "batch_size": 200, "n_epochs": 4, "gamma": 0.9, "learning_rate": 5e-4}
model = PPO(policy, VecMonitor(make(16, seed=0)), policy_kwargs={"log_std_init": -0.5}, seed=0, **settings)
print(f"success before: {success(model):.2f}", flush=True)
for _ in range(5):
    model.learn(DECISIONS // 5, reset_num_timesteps=False)
    print(f"success after {model.num_timesteps} decisions: {success(model):.2f}", flush=True)
