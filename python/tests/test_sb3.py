"""Stable-Baselines3 learns from the environments, where it is installed.

Where it is not, the adapter itself is tested on a base class that keeps its rules.
"""

import importlib
import importlib.util
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

import covers_envs

INSTALLED = importlib.util.find_spec("stable_baselines3") is not None
SAME_STEP = {"autoreset_mode": "SameStep"}
needs_sb3 = pytest.mark.skipif(not INSTALLED, reason="Stable-Baselines3 is not installed")


class Base:
    """What the adapter uses of Stable-Baselines3's `VecEnv`."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self._reset_seeds()

    def _reset_seeds(self):
        self._seeds = [None] * self.num_envs

    def _reset_options(self):
        pass

    def step(self, actions):
        self.step_async(actions)
        return self.step_wait()


@pytest.fixture
def adapter(monkeypatch):
    if not INSTALLED:
        names = "stable_baselines3", "stable_baselines3.common", "stable_baselines3.common.vec_env"
        modules = [ModuleType(name) for name in names]
        modules[-1].VecEnv = Base
        for module in modules:
            monkeypatch.setitem(sys.modules, module.__name__, module)
        # imported afresh, and forgotten at the end with the modules above
        monkeypatch.setitem(sys.modules, "covers_envs.sb3", None)
        monkeypatch.delitem(sys.modules, "covers_envs.sb3")
    return importlib.import_module("covers_envs.sb3").SB3VecEnv


@pytest.mark.parametrize("only", [None, "image", "vector"])
def test_a_stored_observation_is_not_changed_by_the_next_step(adapter, only):
    """Stable-Baselines3 stores an observation after the step that follows it."""
    settings = {"image_size": 16, "horizon": 30, "embodiment": "hand", "seed": 0} | SAME_STEP
    env = adapter(covers_envs.make_vec("goal-reach", 2, **settings), only=only)
    twin = covers_envs.make_vec("goal-reach", 2, **settings)

    def contents(observation):
        parts = observation if only is None else {only: observation}
        return {name: array.tobytes() for name, array in parts.items()}

    last, stored, terminal = env.reset(), [], []
    expected, ends = [twin.reset()[0]], []
    for _ in range(5):
        actions = np.full((2, 4), 0.5, np.float32)
        following, _, _, infos = env.step(actions)
        stored.append(last)
        last = following
        terminal += [info["terminal_observation"] for info in infos if "terminal_observation" in info]
        observation, *_, infos = twin.step(actions)
        expected.append({name: array.copy() for name, array in observation.items()})
        ends += [{name: array.copy() for name, array in each.items()} for each in infos.get("final_obs", [])]
    shown = [each if only is None else {only: each[only]} for each in expected + ends]
    assert len(ends) == 2
    assert [contents(each) for each in [*stored, last, *terminal]] == [
        {name: array.tobytes() for name, array in each.items()} for each in shown
    ]
    assert contents(stored[0]) != contents(stored[1])


def test_shared_arrays_are_refused(adapter):
    shared = covers_envs.make_vec("goal-reach", 2, image_size=16, copy=False, **SAME_STEP)
    with pytest.raises(ValueError, match="`copy=False`, expected `copy=True`: Stable-Baselines3 stores"):
        adapter(shared)


def test_other_autoreset_modes_are_refused(adapter):
    with pytest.raises(ValueError, match="SAME_STEP"):
        adapter(covers_envs.make_vec("goal-reach", image_size=16, autoreset_mode="NextStep"))


@needs_sb3
def test_the_adapter_hands_over_ends_and_success():
    from stable_baselines3.common.vec_env import VecMonitor

    from covers_envs.sb3 import SB3VecEnv

    settings = {"image_size": 16, "embodiment": "hand", "seed": 0} | SAME_STEP
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


@needs_sb3
def test_the_checker_of_sb3_passes_and_experts_are_asked():
    from stable_baselines3.common.env_checker import check_env

    from covers_envs.sb3 import SB3VecEnv

    check_env(covers_envs.make("goal-reach", image_size=36, state=True, render_mode="rgb_array"))
    env = SB3VecEnv(covers_envs.make_vec(["goal-reach", "drawer-close"], 4, image_size=16, seed=0, **SAME_STEP))
    env.reset()
    actions = env.env_method("expert_actions", indices=[0, 3])
    assert len(actions) == 2 and (actions[1] == env.env.expert_actions()[3]).all()


@needs_sb3
@pytest.mark.parametrize(
    ("only", "policy"), [(None, "MultiInputPolicy"), ("vector", "MlpPolicy"), ("state", "MlpPolicy")]
)
def test_ppo_takes_steps(only, policy):
    from stable_baselines3 import PPO

    from covers_envs.sb3 import SB3VecEnv

    settings = {"image_size": 36, "max_episode_steps": 5, "embodiment": "hand", "seed": 0} | SAME_STEP
    env = covers_envs.make_vec("goal-reach", 2, state=True, **settings)
    model = PPO(policy, SB3VecEnv(env, only=only), n_steps=8, batch_size=8, n_epochs=1, seed=0)
    model.learn(16)
    assert model.num_timesteps == 16


def test_triton_can_be_loaded_after_a_renderer(tmp_path):
    pytest.importorskip("triton")
    program = "import covers_envs; covers_envs.make_vec('goal-reach').reset(); import triton"
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
