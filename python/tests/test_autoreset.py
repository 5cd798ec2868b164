"""What happens where an episode ends, beside Gymnasium's own vector and beside loops by hand."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import covers_envs

SETTINGS = {"image_size": 16, "horizon": 30}
DECISIONS = 3


def actions(step, n):
    return np.random.default_rng(step).uniform(-1, 1, (n, 4)).astype(np.float32)


def without_type(infos):
    """Gymnasium keeps an observation's fields in a dictionary; so does this package."""
    final = infos.get("final_obs")
    return infos if final is None else infos | {"final_obs": list(final)}


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_one_environment_does_what_gymnasium_makes_of_it(mode):
    ours = covers_envs.make_vec("drawer-close", 1, autoreset_mode=mode, **SETTINGS)
    theirs = SyncVectorEnv([lambda: covers_envs.make("drawer-close", **SETTINGS)], autoreset_mode=mode)
    assert data_equivalence(ours.reset(seed=5)[0], theirs.reset(seed=5)[0], exact=True)
    ends = 0
    for step in range(3 * DECISIONS):
        *left, infos = ours.step(actions(step, 1))
        *right, expected = theirs.step(actions(step, 1))
        for a, b in zip(left, right, strict=True):
            if isinstance(a, dict):
                assert data_equivalence(a, b, exact=True)
            else:
                assert (a == b).all(), step
        ended = left[3].any()
        ends += ended
        if ended and mode is AutoresetMode.SAME_STEP:
            assert data_equivalence(infos["final_obs"][0], expected["final_obs"][0], exact=True)
            assert set(infos["final_info"]) == set(expected["final_info"])
            for name, array in expected["final_info"].items():
                assert (infos["final_info"][name] == array).all(), name
            assert infos["_final_obs"].tolist() == expected["_final_obs"].tolist() == [True]
        elif "success" in expected:
            assert (infos["success"] == expected["success"]).all()
    assert ends >= 2


def test_the_modes_tell_the_same_episodes():
    same, following, by_hand = (
        covers_envs.make_vec("drawer-close", 3, autoreset_mode=mode, seed=2, **SETTINGS)
        for mode in ("SameStep", "NextStep", "Disabled")
    )
    for env in (same, following, by_hand):
        env.reset()
    for _ in range(2):
        for step in range(DECISIONS):
            first, last, last_by_hand = (env.step(actions(step, 3)) for env in (same, following, by_hand))
            assert (first[1] == last[1]).all() and (first[1] == last_by_hand[1]).all()
        assert all(outcome[3].all() for outcome in (first, last, last_by_hand))
        for index in range(3):
            final = first[4]["final_obs"][index]
            for name, array in final.items():
                assert (array == last[0][name][index]).all() and (array == last_by_hand[0][name][index]).all()
        begun = following.step(np.zeros((3, 4), np.float32))
        assert (begun[1] == 0).all() and not begun[3].any() and not begun[4]["_success"].any()
        begun_by_hand, _ = by_hand.reset(options={"reset_mask": np.ones(3, np.bool_)})
        for name, array in first[0].items():
            assert (array == begun[0][name]).all() and (array == begun_by_hand[name]).all()


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_some_begin_while_others_go_on(mode):
    masked, plain = (
        covers_envs.make_vec("goal-reach", 3, autoreset_mode=mode, seed=2, **SETTINGS) for _ in range(2)
    )
    for env in (masked, plain):
        env.reset()
        env.step(actions(0, 3))
    mask = np.array([True, False, True])
    observation, _ = masked.reset(options={"reset_mask": mask})
    outcome, other = masked.step(actions(1, 3)), plain.step(actions(1, 3))
    assert outcome[1][1] == other[1][1]
    assert (outcome[0]["image"][1] == other[0]["image"][1]).all()
    third, other = masked.step(actions(2, 3)), plain.step(actions(2, 3))
    assert third[3].tolist() == [False, True, False] and other[3].all()
    if mode == "Disabled":
        with pytest.raises(RuntimeError, match=r"environments \[1\]: no episode is running"):
            masked.step(actions(3, 3))
        masked.reset(options={"reset_mask": third[3]})
    fourth = masked.step(actions(3, 3))
    assert fourth[3].tolist() == [True, False, True]
    assert (fourth[1][1] == 0) == (mode == "NextStep")
