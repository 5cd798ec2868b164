"""Stable-Baselines3 learns from the environments, where it is installed."""

import subprocess
import sys

import numpy as np
import pytest

import covers_envs

pytest.importorskip("stable_baselines3")


def test_the_adapter_hands_over_ends_and_success():
    from stable_baselines3.common.vec_env import VecMonitor

    from covers_envs.sb3 import SB3VecEnv

    settings = {"image_size": 16, "embodiment": "hand", "seed": 0}
    inner = covers_envs.make_vec("goal-reach", 2, **settings)
    env, twin = VecMonitor(SB3VecEnv(inner)), covers_envs.make_vec("goal-reach", 2, **settings)
    env.seed(4)
    observation, expected = env.reset(), twin.reset(seed=4)[0]
    assert (observation["image"] == expected["image"]).all()
    for step in range(inner.decisions):
        actions = inner.expert_actions()
        observation, _, dones, infos = env.step(actions)
        twin_outcome = twin.step(actions)
        assert (observation["vector"] == twin_outcome[0]["vector"]).all()
    assert dones.all()
    for index, info in enumerate(infos):
        assert info["is_success"] and info["TimeLimit.truncated"] and info["episode"]["l"] == 50
        assert (info["terminal_observation"]["image"] == twin_outcome[4]["final_obs"][index]["image"]).all()
    infos = env.step(np.zeros((2, 4), np.float32))[3]
    assert not infos[0]["is_success"], "a new episode"


@pytest.mark.parametrize(("only", "policy"), [(None, "MultiInputPolicy"), ("vector", "MlpPolicy")])
def test_ppo_takes_steps(only, policy):
    from stable_baselines3 import PPO

    from covers_envs.sb3 import SB3VecEnv

    env = covers_envs.make_vec("goal-reach", 2, image_size=36, horizon=50, embodiment="hand", seed=0)
    model = PPO(policy, SB3VecEnv(env, only=only), n_steps=8, batch_size=8, n_epochs=1, seed=0)
    model.learn(16)
    assert model.num_timesteps == 16


def test_triton_can_be_loaded_after_a_renderer(tmp_path):
    pytest.importorskip("triton")
    program = "import covers_envs; covers_envs.make_vec('goal-reach').reset(); import triton"
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)


def test_other_autoreset_modes_are_refused():
    from covers_envs.sb3 import SB3VecEnv

    with pytest.raises(ValueError, match="SAME_STEP"):
        SB3VecEnv(covers_envs.make_vec("goal-reach", image_size=16, autoreset_mode="NextStep"))
