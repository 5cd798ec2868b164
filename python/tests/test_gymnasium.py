"""What Gymnasium asks of environments."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import covers_envs

SMALL = {"image_size": 16, "horizon": 30}


@pytest.mark.parametrize("task", ["goal-reach", "drawer-close-half-turn"])
def test_the_checker_of_gymnasium_passes_without_a_warning(task):
    env = covers_envs.make(task, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # it would make a second environment from a specification, which this one lacks
        warnings.filterwarnings("ignore", message=".*spec.*")
        check_env(env)


def test_a_registered_name_makes_one_or_many():
    names = [name for name in gymnasium.registry if name.startswith("covers/")]
    assert len(names) == len(covers_envs.TASKS) == 14 * 5
    one = gymnasium.make("covers/GoalReach-v0", **SMALL)
    assert isinstance(one.unwrapped, covers_envs.CoversEnv)
    check_env(one.unwrapped)
    many = gymnasium.make_vec("covers/PlateSlideFlipX-v0", num_envs=3, threads=2, **SMALL)
    assert isinstance(many, covers_envs.CoversVectorEnv) and many.num_envs == 3


@pytest.mark.parametrize("layout", ["symmetric", "metaworld"])
def test_spaces_contain_what_environments_show(layout):
    env = covers_envs.make_vec("button-press", 3, layout=layout, image_size=16, horizon=30, seed=1)
    env.action_space.seed(0)
    observation, _ = env.reset()
    assert env.observation_space.contains(observation)
    for _ in range(8):
        observation, rewards, *_ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert ((0 <= rewards) & (rewards <= 1)).all()


def test_wrappers_of_gymnasium_count_episodes():
    env = RecordEpisodeStatistics(covers_envs.make_vec("goal-reach", 2, seed=0, **SMALL))
    env.reset()
    total = np.zeros(2)
    for _ in range(3):
        _, rewards, _, truncated, infos = env.step(np.zeros((2, 4), np.float32))
        total += rewards
    assert truncated.all()
    np.testing.assert_allclose(infos["episode"]["r"], total, rtol=1e-6)
    assert (infos["episode"]["l"] == 3).all()


def test_pictures_are_shown_enlarged():
    env = covers_envs.make_vec("goal-reach", 2, seed=0, render_mode="rgb_array", **SMALL)
    observation, _ = env.reset()
    pictures = env.render()
    assert len(pictures) == 2 and pictures[0].shape == (480, 480, 3)
    assert (pictures[1][::30, ::30] == observation["image"][1, ..., :3]).all()
    assert covers_envs.make_vec("goal-reach", **SMALL).render() is None


@pytest.mark.parametrize("mode", AutoresetMode)
def test_the_autoreset_mode_is_in_the_metadata(mode):
    env = covers_envs.make_vec("goal-reach", autoreset_mode=mode, **SMALL)
    assert env.metadata["autoreset_mode"] is mode
