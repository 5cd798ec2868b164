"""Conventions of Gymnasium beyond its checkers, and what states, rewards and seeds tell."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, NormalizeObservation

import covers_envs

SMALL = {"image_size": 16, "horizon": 30, "embodiment": "hand"}
MODES = ["SameStep", "NextStep"]


def zeros(env):
    return np.zeros(env.action_space.shape, np.float32)


def make(task="drawer-close", n=3, **settings):
    return covers_envs.make_vec(task, n, **SMALL | {"seed": 0} | settings)


def equal(first, second):
    return all((first[name] == second[name]).all() for name in second)


def test_the_default_autoreset_mode_is_that_of_gymnasium_and_its_wrappers_accept_it():
    """Case E4."""
    env = gymnasium.make_vec("covers/GoalReach-v0", num_envs=2, **SMALL)
    theirs = gymnasium.make_vec("CartPole-v1", num_envs=2)
    assert env.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    for wrapped in (FlattenObservation(env), NormalizeObservation(FlattenObservation(env))):
        wrapped.reset(seed=0)
        wrapped.step(zeros(wrapped))


def test_specifications_and_keywords_tell_the_number_of_steps():
    """Case E5."""
    one, many = gymnasium.make("covers/GoalReach-v0"), gymnasium.make_vec("covers/GoalReach-v0", num_envs=2)
    assert one.spec.max_episode_steps == many.spec.max_episode_steps == 50
    assert gymnasium.make("covers/GoalReach-v0", layout="metaworld").spec.max_episode_steps == 500
    assert gymnasium.make(one.spec).spec.max_episode_steps == 50
    env = gymnasium.make_vec("covers/GoalReach-v0", num_envs=2, max_episode_steps=5, image_size=16)
    assert (
        env.spec.max_episode_steps == 5
        and gymnasium.make("covers/GoalReach-v0", horizon=60).spec.max_episode_steps == 6
    )
    env.reset(seed=0)
    assert [env.step(zeros(env))[3].all() for _ in range(5)] == [False] * 4 + [True]
    single = gymnasium.make("covers/GoalReach-v0", max_episode_steps=5, image_size=16)
    single.reset(seed=0)
    assert [single.step(np.zeros(4))[3] for _ in range(5)] == [False] * 4 + [True]


def test_render_needs_a_reset_and_shows_what_callers_cannot_change():
    """Case E6."""
    for env in (make(render_mode="rgb_array"), covers_envs.make("goal-reach", render_mode="rgb_array", image_size=16)):
        with pytest.raises(RuntimeError, match="no image yet: call `reset` before `render`"):
            env.render()
        observation, _ = env.reset()
        before = np.array(env.render())
        observation["image"][:] = 0
        assert (np.array(env.render()) == before).all() and before.any()


def test_integer_actions_are_taken_and_settings_of_vectors_are_refused_by_name():
    """Case E7."""
    env, same = make(), make()
    env.reset(), same.reset()
    whole = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    assert equal(env.step(whole)[0], same.step(whole.astype(np.float16))[0])
    single = covers_envs.make("goal-reach", image_size=16)
    single.reset(seed=0)
    single.step([1, 0, 0, 0])
    for name in ("num_envs", "autoreset_mode"):
        with pytest.raises(ValueError, match=f"`{name}` is a setting of `make_vec`"):
            covers_envs.make("goal-reach", **{name: 3})


def test_a_list_of_seeds_gives_the_episodes_of_single_environments():
    env, singles = make(seed=[7, 8, 7]), [covers_envs.make("drawer-close", **SMALL) for _ in range(2)]
    first, _ = env.reset()
    for seeds in ([7, 8, 7], [3, 4, 5]):
        observation, _ = env.reset(seed=seeds)
        for row, single in enumerate(singles):
            expected, _ = single.reset(seed=seeds[row])
            assert equal({name: array[row] for name, array in observation.items()}, expected)
    assert (first["image"][0] == first["image"][2]).all() and (first["image"][0] != first["image"][1]).any()


def test_unknown_options_are_refused():
    for env in (make(), covers_envs.make("goal-reach", image_size=16), make(["push", "goal-reach"]),
                covers_envs.make_mt1("goal-reach", image_size=16)):  # fmt: skip
        with pytest.raises(ValueError, match=r"unknown options \['gaol'\] of `reset`"):
            env.reset(options={"gaol": 1})


@pytest.mark.parametrize("settings", [{}, {"copy": False}, {"randomisation": {}}, {"state": True}])
def test_a_restored_state_continues_to_the_same_bits(settings):
    env = make("push", autoreset_mode="SameStep", render_mode="rgb_array", **settings)
    env.reset()
    rng = np.random.default_rng(0)
    env.step(rng.uniform(-1, 1, (3, 4)))
    last, picture = {name: array.copy() for name, array in env.step(zeros(env))[0].items()}, env.render()
    state, actions = env.save_state(), rng.uniform(-1, 1, (5, 3, 4))

    def rollout():
        steps = [env.step(each) for each in actions]
        return b"".join(array.tobytes() for step in steps for array in (*step[0].values(), step[1], step[3]))

    expected = rollout()
    for _ in range(2):
        assert equal(env.restore_state(state), last)
        assert (np.array(env.render()) == np.array(picture)).all()
        assert rollout() == expected
    other = make("goal-reach", **settings)
    with pytest.raises(ValueError, match="the snapshot is of push with hand"):
        other.restore_state(state)
    with pytest.raises(RuntimeError, match="no episode is running"):
        make().save_state()


def test_tasks_are_mixed_in_one_vector():
    tasks = ["goal-reach", "drawer-close-flip-x", "push"]
    env = make(tasks, 7, seed=4, autoreset_mode="SameStep", render_mode="rgb_array", state=True)
    assert isinstance(env, covers_envs.MixedVectorEnv) and env.tasks == tuple(tasks)
    observation, _ = env.reset()
    assert env.observation_space.contains(observation) and len(env.render()) == 7
    single = covers_envs.make(tasks[1], state=True, **SMALL)
    expected, _ = single.reset(seed=4 + 4)
    assert equal({name: array[4] for name, array in observation.items()}, expected)
    state = env.save_state()
    for _ in range(3):
        actions = env.expert_actions()
        observation, rewards, terminated, truncated, infos = env.step(actions)
        after = single.step(actions[4])
        assert rewards[4] == np.float32(after[1]) and infos["success"][4] == after[4]["success"]
    assert truncated.all() and not terminated.any()
    assert equal(infos["final_obs"][4], after[0])
    assert infos["final_info"]["goal_distance"].shape == infos["approach_reward"].shape == (7,)
    assert equal(env.restore_state(state), env.restore_state(state))
    mask = np.arange(7) == 2
    assert env.reset(options={"reset_mask": mask})[0]["image"].shape == (7, 16, 16, 6)
    assert not isinstance(make(["push", "push-flip-x"]), covers_envs.MixedVectorEnv)
    env.close()


@pytest.mark.parametrize("mode", MODES)
def test_states_tell_where_objects_are_and_infos_the_terms_of_rewards(mode):
    env = make("drawer-close", state=True, horizon=None, max_episode_steps=20, autoreset_mode=mode)
    plain = make("drawer-close", horizon=None, max_episode_steps=20, autoreset_mode=mode)
    observation, _ = env.reset()
    plain.reset()
    assert env.observation_space.contains(observation) and observation["state"].shape == (3, 13)
    start = observation["state"]
    assert (start[:, :4] == observation["vector"][:, :4]).all()
    for _ in range(20):
        actions = env.expert_actions()
        observation, rewards, _, truncated, infos = env.step(actions)
        same, same_rewards, *_ = plain.step(actions)
        assert (rewards == same_rewards).all() and equal(observation, same)
        assert ((0 <= infos["in_place_reward"]) & (infos["in_place_reward"] <= 1)).all()
    assert truncated.all()
    final = np.array([each["state"] for each in infos["final_obs"]]) if mode == "SameStep" else observation["state"]
    terms = infos["final_info"] if mode == "SameStep" else infos
    # the drawer went to its goal
    distance = np.linalg.norm(final[:, 4:7] - final[:, 10:13], axis=1)
    assert (distance < 0.5 * np.linalg.norm(start[:, 4:7] - start[:, 10:13], axis=1)).all()
    np.testing.assert_allclose(terms["goal_distance"], distance, atol=1e-5)


def test_randomised_images_can_be_seen():
    env, plain = make(randomisation={"noise_sd": 9.0}), make()
    assert env.settings["randomisation"]["noise_sd"] == 9.0 and plain.settings["randomisation"] is None
    assert (env.reset()[0]["image"] != plain.reset()[0]["image"]).any()
    assert make(**{name: value for name, value in env.settings.items() if name not in SMALL}).settings["randomisation"]


def test_other_cameras_show_the_scene_with_and_without_the_arm():
    pictures = {}
    for camera, arm in (("top", True), ("top", False), ("corner", True), ("corner", False)):
        env = make(embodiment="sawyer", render_mode="rgb_array", render_camera=camera, render_arm=arm)
        env.reset()
        first = np.array(env.render())
        assert first.shape == (3, 480, 480, 3) and len(np.unique(first)) > 5
        env.step(np.ones((3, 4)))
        assert not arm or (np.array(env.render()) != first).any()
        pictures[camera, arm] = first
    for camera in ("top", "corner"):
        assert (pictures[camera, True] != pictures[camera, False]).any()
    assert (pictures["top", False] != pictures["corner", False]).any()
    with pytest.raises(ValueError, match="render_camera is 'side', expected None, 'top' or 'corner'"):
        make(render_camera="side")
