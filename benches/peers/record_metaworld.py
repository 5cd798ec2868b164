"""Records episodes of Meta-World for `covers check parity`: one ENGINE_TASK_POLICY.npz a task and policy.

benches/peers/record_metaworld.sh FOLDER [TASK ...] sets up what it needs: Python 3.10, mujoco 2.2.2, metaworld 3.1.1.

E episodes of T control steps. Index 0 of an axis of T + 1 is the state after the reset. Lengths in metres, Meta-World's frame.
  qpos [E, T + 1, nq], qvel [E, T + 1, nv], mocap_pos [E, T + 1, 3], obs [E, T + 1, 39], action [E, T, 4] (not clipped), reward [E, T],
  info [E, T, 7] in the order of INFO, mesh_contact [E, T] (a convex mesh touched something), rand_vec [E, k], target_pos, hand_init_pos,
  init_tcp [E, 3].
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from metaworld.policies import ENV_POLICY_MAP

STEPS = 100
# with experts of this file, and with Meta-World's own
OWN = ["reach", "button-press", "drawer-close", "plate-slide"]
STOCK = ["window-open", "window-close", "door-open", "door-close", "drawer-open", "button-press-topdown", "faucet-close",
         "push", "pick-place", "peg-insert-side"]
INFO = ["success", "near_object", "grasp_success", "grasp_reward", "in_place_reward", "obj_to_target", "unscaled_reward"]


def make(task):
    """The environment on MuJoCo 2.2.2: weld torquescale 1, and no look-up by name where that release has none."""
    env = ALL_V3_ENVIRONMENTS[f"{task}-v3"]()
    # the last number of a weld's data; 3.x needs 5 for what was 1 before
    env.model.eq_data[0][10] = 1.0
    env._partially_observable = False
    env._freeze_rand_vec = False
    env._set_task_called = True
    env.seeded_rand_vec = True
    meshes = [geom for geom in range(env.model.ngeom) if env.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH]
    env.mesh_touched = False

    def simulate(ctrl, frames):
        env.data.ctrl[:] = ctrl
        env.mesh_touched = False
        for _ in range(frames):
            mujoco.mj_step(env.model, env.data)
            contacts = [env.data.contact[i] for i in range(env.data.ncon)]
            env.mesh_touched |= any(c.geom1 in meshes or c.geom2 in meshes for c in contacts)

    def reset_hand(steps=50):
        for _ in range(steps):
            env.data.mocap_pos[0] = env.hand_init_pos
            env.data.mocap_quat[0] = [1, 0, 1, 0]
            env.do_simulation([-1, 1], env.frame_skip)
        env.init_tcp = env.tcp_center

    # it needs such a look-up, and only `grasp_success` depends on it
    type(env).touching_main_object = False
    env._step_mujoco_simulation = simulate
    env._reset_hand = reset_hand
    return env


def expert(task, observation, goal):
    """A proportional controller: where the hand should go, how hard, and the fingers."""
    if task in STOCK:
        # the environment clips the goal to the zeros of its first observation space
        full = np.concatenate([observation[:-3], goal])
        return np.array(ENV_POLICY_MAP[f"{task}-v3"]().get_action(full), dtype=float)
    hand, thing = observation[:3], observation[4:7]
    if task == "reach":
        return action(5, goal - hand, 0)
    if task == "button-press":
        aim = thing - [0, 0, 0.07]
        beside = max(abs(hand[0] - aim[0]), abs(hand[2] - aim[2])) > 0.02
        to = [aim[0], hand[1] - 0.1, aim[2]] if beside else aim + [0, 0.02, 0]
        return action(25, to - hand, 0)
    if task == "drawer-close":
        aim = thing - [0, 0, 0.02]
        if hand[1] > aim[1]:
            low = hand[2] < aim[2] + 0.23
            to = [hand[0], hand[1], aim[2] + 0.5] if low else aim + [0, -0.075, 0.23]
        else:
            to = aim + [0, -0.075, 0] if abs(hand[2] - aim[2]) > 0.04 else aim
        return action(25, to - hand, 1)
    aim = thing + [0, -0.055, 0.03]
    if np.linalg.norm((hand - aim)[:2]) > 0.03:
        to = aim + [0, 0, 0.1]
    else:
        to = aim if abs(hand[2] - aim[2]) > 0.04 else np.array([goal[0], 0.9, aim[2]])
    return action(10, to - hand, -1)


def action(gain, way, fingers):
    return np.array([*(gain * way), fingers])


def episode(env, task, policy, seed):
    """Two random episodes differ in how long an action is held."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    held, rows = None, {key: [] for key in ["qpos", "qvel", "mocap_pos", "obs", "action", "reward", "info", "mesh_contact"]}

    def look():
        for key in ["qpos", "qvel"]:
            rows[key].append(getattr(env.data, key).copy())
        rows["mocap_pos"].append(env.data.mocap_pos[0].copy())
        rows["obs"].append(observation.copy())

    start = {
        "rand_vec": np.array(env._last_rand_vec, dtype=float),
        "target_pos": np.array(env._target_pos, dtype=float),
        "hand_init_pos": np.array(env.hand_init_pos, dtype=float),
        "init_tcp": np.array(env.init_tcp, dtype=float),
    }
    look()
    for step in range(STEPS):
        if policy == "expert":
            held = expert(task, observation, start["target_pos"])
        elif step % (1 if seed % 2 else 10) == 0:
            held = rng.uniform(-1, 1, 4)
        observation, reward, _, _, info = env.step(held)
        look()
        rows["action"].append(held)
        rows["reward"].append(float(reward))
        rows["info"].append([float(info[key]) for key in INFO])
        rows["mesh_contact"].append(env.mesh_touched)
    return {**start, **{key: np.array(value) for key, value in rows.items()}}


def main(folder):
    assert mujoco.mj_versionString() == "2.2.2", mujoco.mj_versionString()
    tasks = sys.argv[2:] or OWN + STOCK
    unknown = set(tasks) - {*OWN, *STOCK}
    assert not unknown, f"no such task: {', '.join(sorted(unknown))}; expected some of {', '.join(OWN + STOCK)}"
    folder.mkdir(parents=True, exist_ok=True)
    for task in tasks:
        env = make(task)
        for policy in ["expert", "random"]:
            episodes = [episode(env, task, policy, seed) for seed in range(2)]
            arrays = {key: np.stack([one[key] for one in episodes]) for key in episodes[0]}
            np.savez_compressed(folder / f"mj222_{task}_{policy}.npz", **arrays)
            print(task, policy, "success", arrays["info"][:, :, 0].any(axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
