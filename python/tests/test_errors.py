"""Bad input is refused by name, and changes nothing."""

import numpy as np
import pytest

import covers_envs


def make(task="goal-reach", n=2, **settings):
    return covers_envs.make_vec(task, n, **{"image_size": 16, "seed": 0} | settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"task": "goal-reech"}, "unknown task `goal-reech`, did you mean `goal-reach`"),
        ({"task": "button-press-flipx"}, "did you mean `button-press-flip-x`"),
        ({"task": ["goal-reach", "drawer-close"], "n": 1}, "`num_envs` is 1, expected at least 2"),
        ({"task": []}, "no task is named"),
        ({"n": 0}, "setting `num_envs` is 0, expected at least 1"),
        ({"n": -1}, "setting `num_envs` is -1"),
        ({"threads": 0}, "setting `threads` is 0, expected 1 to 1024"),
        ({"extra_images": "closeup"}, "`extra_images` is 'closeup', expected one of first, close_up"),
        ({"camera": {"oversampling": 9}}, "setting `oversampling` is 9, expected a number in 1..=8"),
        ({"camera": {"oversample": 3}}, "setting `camera`: unknown field `oversample`, expected one of `size`"),
        ({"camera": {"beside": "closeup"}}, "setting `camera`: unknown variant `closeup`"),
        ({"camera": {"height": float("nan")}}, "setting `camera`: "),
        ({"image_size": 15}, "is 15, expected an even number"),
        ({"embodiment": "sawer"}, "unknown embodiment `sawer`: expected one of sawyer"),
        ({"layout": "stock"}, "unknown layout `stock`: expected one of symmetric, metaworld"),
        ({"layout": "metaworld", "task": "goal-reach-flip-x"}, "no variant under flip x"),
        ({"horizon": 7}, "7 with action repeat 10, expected a positive multiple"),
        ({"seed": -3}, "setting `seed` is -3"),
        ({"seed": [1, 2, 3]}, "`seed` is a list of 3, expected 2"),
        ({"seed": [1, -2]}, "setting `seed` is -2"),
        ({"horizon": 30, "max_episode_steps": 3}, "`horizon` and `max_episode_steps` both"),
        ({"max_episode_steps": 0}, "horizon"),
        ({"randomisation": {"noise": 3}}, "setting `randomisation`: unknown field `noise`"),
        ({"randomisation": {"noise_sd": 99}}, "noise_sd"),
        ({"render_mode": "human"}, "render_mode is 'human'"),
        ({"autoreset_mode": "never"}, "never"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        make(**settings)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 3), np.float32), r"`actions` has the shape \(2, 3\), expected \(2, 4\)"),
        (np.zeros(4, np.float32), r"`actions` has the shape \(4,\)"),
        (np.zeros((2, 4), bool), "`actions` is of bool, expected real numbers"),
        ([["0"] * 4] * 2, "`actions` is of <U1, expected real numbers"),
        (np.full((2, 4), np.nan, np.float32), "environment 0: component 0 of the action is NaN"),
        (np.full((2, 4), -np.inf), "component 0 of the action is -inf"),
    ],
)
def test_bad_actions_are_refused_and_nothing_moves(actions, message):
    env, untouched = make(), make()
    for each in (env, untouched):
        each.reset()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    good = np.full((2, 4), 0.5)
    assert (env.step(good)[0]["vector"] == untouched.step(good)[0]["vector"]).all()


def test_an_environment_must_be_reset_and_open():
    env, actions = make(), np.zeros((2, 4), np.float32)
    with pytest.raises(RuntimeError, match="no episode is running: call `reset` first"):
        env.step(actions)
    with pytest.raises(RuntimeError, match="no episode is running"):
        env.expert_actions()
    env.reset()
    env.close()
    env.close()
    for call in (lambda: env.step(actions), env.reset, env.expert_actions):
        with pytest.raises(RuntimeError, match="the environment is closed: make a new one"):
            call()


@pytest.mark.parametrize("mask", [[True, False], np.ones(3, np.bool_), np.ones(2)])
def test_a_reset_mask_is_an_array_of_booleans(mask):
    env = make()
    env.reset()
    with pytest.raises(ValueError, match="expected an array of 2 booleans"):
        env.reset(options={"reset_mask": mask})


def test_what_one_part_of_mixed_environments_would_refuse_changes_no_other():
    env, other = (
        covers_envs.make_vec(["goal-reach", "drawer-close"], 2, image_size=16, seed=np.int64(3)) for _ in range(2)
    )
    env.reset(seed=0)
    with pytest.raises(ValueError, match="expected an array of 2 booleans"):
        env.reset(options={"reset_mask": np.ones(3, np.bool_)})
    with pytest.raises(ValueError, match="give it without `reset_mask`"):
        env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="not finite"):
        env.step(np.array([[0.0] * 4, [np.nan] * 4], np.float32))
    other.reset(seed=0)
    shown, expected = (each.step(np.zeros((2, 4), np.float32))[0] for each in (env, other))
    assert all(np.array_equal(shown[name], expected[name]) for name in expected)


def test_a_seed_is_for_all():
    env = make()
    env.reset()
    with pytest.raises(ValueError, match="`seed` is for all environments"):
        env.reset(seed=1, options={"reset_mask": np.array([True, False])})


def test_one_environment_must_be_reset_after_its_end():
    env = covers_envs.make("goal-reach", image_size=16, horizon=10)
    env.reset(seed=0)
    assert env.step(env.expert_action())[3]
    with pytest.raises(RuntimeError, match="no episode is running: call `reset` first"):
        env.step(np.zeros(4, np.float32))


def test_one_environment_refuses_shared_arrays():
    """Gymnasium's vectors would give the next episode's observation as `final_obs`."""
    with pytest.raises(ValueError, match="`copy` is False, expected True"):
        covers_envs.make("goal-reach", copy=False)
    env = covers_envs.make("goal-reach", image_size=16, seed=0, copy=True)
    first, _ = env.reset()
    kept = {name: array.copy() for name, array in first.items()}
    env.step(np.ones(4, np.float32))
    assert all((first[name] == kept[name]).all() for name in kept)
