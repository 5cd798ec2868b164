"""Seeds, threads, memory, and the bytes that the Rust environments show."""

import os
import subprocess

import numpy as np
import pytest

import covers_envs

SETTINGS = {"image_size": 16, "horizon": 40, "autoreset_mode": "SameStep"}


def trace(env, steps=6, seed=None):
    """All bytes of a reset and so many steps."""
    observation, _ = env.reset(seed=seed)
    none = np.zeros(env.num_envs, np.bool_)
    shown = [observation["image"], observation["vector"], np.zeros(env.num_envs, np.float32), none, none, none]
    for step in range(steps):
        n = env.num_envs * 4
        actions = ((np.arange(n) * 7 + step * 3) % 5).astype(np.float32) / 2 - 1
        observation, rewards, _, truncated, infos = env.step(actions.reshape(-1, 4))
        flags = infos["success"], infos["success_at_end"], truncated
        shown += [observation["image"], observation["vector"], rewards, *(array.copy() for array in flags)]
    return b"".join(array.tobytes() for array in shown)


def make(n=3, **settings):
    return covers_envs.make_vec("drawer-close", n, **SETTINGS | settings)


@pytest.mark.parametrize(
    ("extra_images", "channels"), [(None, 6), ("first", 6), ("close_up", 6), ("first_and_close_up", 9)]
)
def test_the_bytes_are_those_of_the_rust_environments(extra_images, channels):
    program = os.environ.get("COVERS_BYTES")
    if program is None:
        pytest.skip("COVERS_BYTES does not name the program of examples/bytes.rs")
    arguments = [program] if extra_images is None else [program, extra_images]
    rust = subprocess.run(arguments, capture_output=True, check=True).stdout
    env = make(seed=7, extra_images=extra_images)
    assert env.single_observation_space["image"].shape == (16, 16, channels)
    assert trace(env) == rust


def test_extra_images_are_the_first_ones_and_close_ups():
    first, close, both = (
        make(seed=7, extra_images=extra, camera={"oversampling": 3})
        for extra in ("first", "close_up", "first_and_close_up")
    )
    for env in (first, close, both):
        env.reset()
    actions = np.full((3, 4), 0.5, np.float32)
    first, close, both = (env.step(actions)[0]["image"] for env in (first, close, both))
    assert (both == np.concatenate([first, close[..., 3:]], axis=3)).all()
    assert (first[..., 3:] != close[..., 3:]).any()


def test_a_camera_is_made_of_its_own_fields():
    default, fine = make(), make(camera={"oversampling": 3, "size": 20, "beside": "close_up"}, image_size=None)
    assert default.settings["camera"]["oversampling"] == 1
    changed = {"oversampling": 3, "size": 20, "beside": "close_up"}
    assert fine.settings["camera"] == default.settings["camera"] | changed
    assert fine.single_observation_space["image"].shape == (20, 20, 6)
    # what an environment says of itself makes another one like it
    again = covers_envs.make_vec("drawer-close", 3, seed=5, autoreset_mode="SameStep", **fine.settings)
    assert trace(again) == trace(fine, seed=5)
    coarse = fine.settings["camera"] | {"oversampling": 1}
    assert trace(make(seed=5, camera=coarse, image_size=None)) != trace(again)
    # keywords come before fields of the camera
    assert make(camera={"size": 20, "beside": "close_up"}, extra_images="first").settings == default.settings


def test_equal_seeds_give_equal_episodes():
    env, other = make(), make(seed=3)
    first = trace(env, seed=3)
    assert trace(env) != first
    assert trace(env, seed=3) == first == trace(other)
    assert trace(env, seed=4) != first
    assert trace(make()) != trace(make()), "a seed is drawn where none is given"


def test_threads_and_neighbours_change_nothing():
    assert trace(make(threads=1, seed=3)) == trace(make(threads=2, seed=3))
    few, many = make(n=1, seed=3), make(n=3, seed=3)
    one, three = few.reset()[0], many.reset()[0]
    assert (one["image"][0] == three["image"][0]).all()


def test_arrays_belong_to_the_caller_unless_shared_ones_are_asked_for():
    zeros = np.zeros((3, 4), np.float32)
    env = make(seed=3)
    first, _ = env.reset()
    kept = {name: array.copy() for name, array in first.items()}
    second = env.step(zeros + 1)[0]
    assert all((first[name] == kept[name]).all() for name in kept)
    assert not any(np.shares_memory(first[name], second[name]) for name in kept)
    assert all(array.flags.writeable for array in second.values())
    shared = make(seed=3, copy=False)
    before, _ = shared.reset()
    after = shared.step(zeros + 1)[0]
    assert all(before[name] is after[name] for name in kept)
    assert all((after[name] == second[name]).all() for name in kept)


@pytest.mark.parametrize("task", covers_envs.TASKS[14:])
def test_the_scripted_expert_solves_every_task(task):
    env = covers_envs.make_vec(task, 2, image_size=16, embodiment="hand", seed=1)
    env.reset()
    succeeded = np.zeros(2, np.bool_)
    for _ in range(env.decisions):
        infos = env.step(env.expert_actions())[4]
        succeeded |= infos["success"]
    assert succeeded.all()


def test_a_list_of_variants_draws_from_them():
    env = covers_envs.make_vec(["goal-reach-flip-x", "goal-reach-half-turn"], 16, seed=0, **SETTINGS)
    goals = env.reset()[0]["vector"][:, 4:6]
    assert (goals[:, 0] < 0).all() and (goals[:, 1] < 0).any() and (goals[:, 1] > 0).any()


def test_a_vector_switches_tasks():
    env = make(seed=3)
    env.reset()
    env.set_task("goal-reach")
    with pytest.raises(RuntimeError, match="no episode is running"):
        env.step(np.zeros((3, 4), np.float32))
    assert (env.reset(seed=9)[0]["vector"][:, 6] > 0).all()
    fresh = covers_envs.make_vec("goal-reach", 3, seed=9, **SETTINGS)
    assert trace(env, seed=9) == trace(fresh)
