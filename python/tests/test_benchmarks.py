"""Meta-World's conventions: fixed lists of goals, and two lists that share none."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import covers_envs

SMALL = {"image_size": 16, "seed": 0}
MT10 = [
    "goal-reach", "push", "pick-place", "door-open", "drawer-open", "drawer-close", "button-press-topdown",
    "peg-insert-side", "window-open", "window-close",
]  # fmt: skip


def goals(**settings):
    """The goals that Goal Reach tells, of the whole list."""
    env = covers_envs.make_mt1("goal-reach", **SMALL, **settings)
    return {tuple(env.reset(options={"goal": goal})[0]["vector"][4:7]) for goal in range(50)}


def test_a_list_has_fifty_goals_and_the_lists_share_none():
    train, test = goals(), goals(split="test")
    assert len(train) == len(test) == 50
    assert not train & test
    assert train == goals() and not train & goals(goal_seed=1)


def test_episodes_draw_from_the_list_by_the_seed_of_the_reset():
    env = covers_envs.make_mt1("window-open", **SMALL)
    drawn = [env.reset(seed=3)[1]["goal"], *(env.reset()[1]["goal"] for _ in range(20))]
    assert drawn == [env.reset(seed=3)[1]["goal"], *(env.reset()[1]["goal"] for _ in range(20))]
    assert len(set(drawn)) > 10
    first, _ = env.reset(options={"goal": drawn[0]})
    again, info = env.reset(seed=3)
    assert info["goal"] == drawn[0]
    np.testing.assert_array_equal(first["image"], again["image"])


def test_the_seed_of_an_environment_decides_the_goals_without_a_seed_of_the_reset():
    def drawn(seed):
        env = covers_envs.make_mt1("goal-reach", image_size=16, seed=seed)
        return [env.reset()[1]["goal"] for _ in range(20)]

    assert drawn(5) == drawn(5) != drawn(6)
    env = covers_envs.make_mt10(**SMALL)
    goals = env.reset()[1]["goal"]
    assert len(set(goals)) > 1, "tasks draw goals of their own"
    assert list(goals) == list(covers_envs.make_mt10(**SMALL).reset()[1]["goal"])


def test_the_checker_of_gymnasium_passes():
    check_env(covers_envs.make_mt1("push", **SMALL), skip_render_check=True)


def test_mt10_steps_its_ten_tasks_together():
    env = covers_envs.make_mt10(**SMALL)
    assert [list(covers_envs.TASK_SETS["mt10"]), env.num_envs] == [MT10, 10]
    observation, infos = env.reset(seed=0)
    assert observation["vector"].shape == (10, 10) and len(infos["goal"]) == 10
    # Meta-World's control: an action moves the hand within 12.5 ms
    assert env.envs[0].settings["action_repeat"] == 1
    observation, rewards, *_ = env.step(np.zeros((10, 4), np.float32))
    assert rewards.shape == (10,) and len(np.unique(observation["image"].reshape(10, -1), axis=0)) == 10
    env.close()


@pytest.mark.parametrize(
    ("settings", "goal", "message"),
    [({"split": "valid"}, 0, "`split` is 'valid'"), ({}, 50, "`goal` is 50"), ({}, "a", "`goal` is 'a'")],
)
def test_what_is_no_list_and_no_goal_is_refused(settings, goal, message):
    with pytest.raises(ValueError, match=message):
        covers_envs.make_mt1("goal-reach", **SMALL, **settings).reset(options={"goal": goal})
