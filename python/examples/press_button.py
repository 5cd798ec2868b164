"""A policy of this repository presses buttons from images: press_button.py FOLDER

FOLDER holds the policy that `covers export assets/pretrained --policy 0 --out FOLDER` wrote.
"""

import sys

import numpy as np

import covers_envs

folder = sys.argv[1]
env = covers_envs.make_vec("button-press", 64, seed=0, **covers_envs.policy_settings(folder))
policy = covers_envs.OnnxPolicy(folder, env)
observation, _ = env.reset()
succeeded = np.zeros(env.num_envs, bool)
for _ in range(env.decisions):
    observation, _, _, _, infos = env.step(policy(observation))
    succeeded |= infos["success"]
print(f"the policy pressed {succeeded.sum()} of {env.num_envs} buttons")
