"""Policies of `assets/pretrained`, exported, score from Python what `covers eval` says of them."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import covers_envs

if "COVERS_POLICIES" not in os.environ:
    pytest.skip("COVERS_POLICIES does not name a folder of exported policies", allow_module_level=True)
import onnxruntime  # noqa: E402, F401  where policies are named, it must be there

POLICIES = Path(os.environ["COVERS_POLICIES"])

#: Policy, success and return of 500 of each group, by assets/pretrained/README.md.
GROUPS = {
    "goal-reach": (2, 1.00, 484),
    "button-press": (0, 1.00, 443),
    "drawer-close": (1, 0.97, 431),
    "plate-slide": (3, 0.99, 408),
}
EPISODES = 32


def play(env, policy):
    """Share of episodes that succeed, and the mean return on the scale of 500."""
    observation, _ = env.reset()
    succeeded, total = np.zeros(env.num_envs, np.bool_), 0.0
    for _ in range(env.decisions):
        observation, rewards, _, _, infos = env.step(policy(observation))
        succeeded |= infos["success"]
        total += rewards.mean()
    return succeeded.mean(), 500 * total / env.decisions


@pytest.mark.parametrize("task", GROUPS)
def test_an_exported_policy_scores_what_the_learner_does(task):
    number, success, earned = GROUPS[task]
    folder = POLICIES / str(number)
    env = covers_envs.make_vec(task, EPISODES, seed=11, **covers_envs.policy_settings(folder))
    scored = play(env, covers_envs.OnnxPolicy(folder, env))
    # one failure in 32 episodes is 0.031
    assert scored[0] >= success - 0.035, scored
    assert abs(scored[1] - earned) < 20, scored


def test_one_environment_is_played_too():
    folder = POLICIES / "0"
    settings = covers_envs.policy_settings(folder)
    env = covers_envs.make("button-press", seed=11, **settings)
    many = covers_envs.make_vec("button-press", 1, seed=11, **settings)
    policy = covers_envs.OnnxPolicy(folder, env)
    observation, expected = env.reset()[0], many.reset()[0]
    actions = policy(observation)
    assert actions.shape == (4,) and (actions == policy(expected)[0]).all()
    assert env.observation_space.contains(env.step(actions)[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"extra_images": "first"}, "camera.beside is 'first', expected 'close_up'"),
        ({"extra_images": "first_and_close_up"}, "camera.beside is 'first_and_close_up', expected 'close_up'"),
        ({"image_size": 50}, "camera.size is 50, expected 48"),
        ({"displacement": 0.02}, "displacement is 0.02, expected 0.04"),
        ({"action_repeat": 5}, "action_repeat is 5, expected 10"),
        ({"camera": {}, "extra_images": "close_up"}, "camera.oversampling is 1, expected 3"),
        ({"layout": "metaworld"}, "layout is 'metaworld', expected 'symmetric'"),
    ],
)
def test_other_images_and_other_actions_are_refused(changes, message):
    folder = POLICIES / "0"
    env = covers_envs.make_vec("button-press", 1, **covers_envs.policy_settings(folder) | changes)
    with pytest.raises(ValueError, match=message):
        covers_envs.OnnxPolicy(folder, env)


def test_the_default_images_are_refused():
    with pytest.raises(ValueError, match="camera.beside is 'first', expected 'close_up'"):
        covers_envs.OnnxPolicy(POLICIES / "0", covers_envs.make_vec("button-press"))
    with pytest.raises(TypeError, match="expected a CoversEnv or a CoversVectorEnv"):
        covers_envs.OnnxPolicy(POLICIES / "0", None)


def test_a_policy_without_images_has_no_camera(tmp_path):
    shutil.copytree(POLICIES / "0", tmp_path / "policy")
    path = tmp_path / "policy" / "policy.json"
    about = json.loads(path.read_text())
    assert "camera" in covers_envs.policy_settings(tmp_path / "policy")
    del about["inputs"]["image"]
    path.write_text(json.dumps(about))
    assert "camera" not in covers_envs.policy_settings(tmp_path / "policy")


@pytest.mark.parametrize(("field", "value"), [("format", "covers-policy 0"), ("environment", None)])
def test_a_description_of_another_version_is_refused(tmp_path, field, value):
    shutil.copytree(POLICIES / "0", tmp_path / "policy")
    path = tmp_path / "policy" / "policy.json"
    about = json.loads(path.read_text())
    about[field] = value
    path.write_text(json.dumps({name: each for name, each in about.items() if each is not None}))
    with pytest.raises(ValueError, match="export the policy again"):
        covers_envs.policy_settings(tmp_path / "policy")
