"""Decisions that PPO takes to solve CartPole and Pendulum, here and in Stable-Baselines3: classic_control.py [SEEDS]

Both have the settings below, networks of their own (two hidden layers), and a rollout's mean over the
last 100 episodes says when a task is solved. Needs stable-baselines3 2.9 and
`cargo build --release --locked -p covers-rl --example classic_control`.
"""

import subprocess
import sys
from pathlib import Path
from statistics import mean, median

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

SEEDS = int(sys.argv[1]) if len(sys.argv) > 1 else 5
PROGRAM = Path(sys.argv[2] if len(sys.argv) > 2 else "target/release/examples/classic_control")
DECISIONS = 200_000

#: Task, environments, mean return that solves it, and settings: those of RL Zoo 2.3 without the decay of
#: the clip interval in CartPole and without state-dependent exploration in Pendulum.
TASKS = {
    "cart-pole": ("CartPole-v1", 8, 475, {
        "n_steps": 32, "batch_size": 256, "n_epochs": 20, "gamma": 0.98, "gae_lambda": 0.8,
        "learning_rate": lambda left: 1e-3 * left,
    }),
    "pendulum": ("Pendulum-v1", 4, -200, {
        "n_steps": 1024, "batch_size": 64, "n_epochs": 10, "gamma": 0.9, "gae_lambda": 0.95,
        "learning_rate": 1e-3,
    }),
}  # fmt: skip


class UntilSolved(BaseCallback):
    """Ends training where the last 100 episodes returned enough on average."""

    def __init__(self, solved):
        super().__init__()
        self.solved, self.decisions = solved, None

    def _on_step(self):
        return self.decisions is None

    def _on_rollout_end(self):
        returns = [episode["r"] for episode in self.model.ep_info_buffer]
        if len(returns) == 100 and mean(returns) >= self.solved:
            self.decisions = self.num_timesteps


def peer(task, seed):
    name, envs, solved, settings = TASKS[task]
    model = PPO("MlpPolicy", make_vec_env(name, envs, seed=seed), ent_coef=0.0, seed=seed, device="cpu", **settings)
    callback = UntilSolved(solved)
    model.learn(DECISIONS, callback)
    return callback.decisions


def ours(task, seed):
    said = subprocess.run([PROGRAM, task, str(seed)], check=True, capture_output=True, text=True).stdout
    return int(said) if said.strip().isdigit() else None


torch.set_num_threads(1)
for task in TASKS:
    runs = {run.__name__: [run(task, seed) for seed in range(SEEDS)] for run in (ours, peer)}
    for name, decisions in runs.items():
        print(task, name, decisions, flush=True)
    ratio = median(n or DECISIONS for n in runs["ours"]) / median(n or DECISIONS for n in runs["peer"])
    print(f"{task}: {ratio:.2f} times the decisions of Stable-Baselines3, medians of {SEEDS} seeds", flush=True)
    assert ratio <= 1.2, task
