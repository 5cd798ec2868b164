"""Times covers_envs in Python, the same environments in Rust, Meta-World and EnvPool in turn: python_envs.py DRIVER ROUNDS.

Everybody gets uniformly random actions, one a control step of 12.5 ms, and one thread. A picture has 64 x 64 pixels.
Figures are medians over rounds; a round asks everybody once. `main thread %` is the processor time of Python's thread, which
hands over actions and makes arrays while Rust's threads sleep, over that of Rust's threads: the cost of Python, also where other
programs disturb the clock on the wall. EnvPool's Meta-World has no pictures; `Rust state` makes none, either.
"""

import sys
import time

import covers_envs
import numpy as np
from envs import ENVS, SIZE, TASKS, EnvPool, MetaWorld, Ours, image, medians, rate


class Python:
    def __init__(self, task, embodiment, copy=True):
        control = {"action_repeat": 1, "displacement": 0.01, "horizon": 500, "autoreset_mode": "SameStep"}
        self.env = covers_envs.make_vec(
            task, ENVS, image_size=SIZE, embodiment=embodiment, threads=1, seed=0, copy=copy, **control
        )
        self.env.reset()
        self.rng = np.random.default_rng(0)
        self.step()

    def step(self):
        self.env.step(self.rng.uniform(-1, 1, (ENVS, 4)).astype(np.float32))

    def main_thread(self):
        actions = self.rng.uniform(-1, 1, (ENVS, 4)).astype(np.float32)
        before = time.thread_time(), time.process_time()
        for _ in range(200):
            self.env.step(actions)
        own, all_threads = time.thread_time() - before[0], time.process_time() - before[1]
        return 100 * own / (all_threads - own)

    def image(self):
        return ENVS * rate(self.step, 10**9)


def measures(driver, task):
    """Name of every column and what measures it."""
    columns = {}
    for embodiment in ("sawyer", "hand"):
        ours = Ours(driver, embodiment)
        columns[f"Rust {embodiment}"] = lambda ours=ours: ours.ask("image", task)
        columns[f"Python {embodiment}"] = Python(task, embodiment).image
        columns[f"shared {embodiment}"] = Python(task, embodiment, copy=False).image
        columns[f"Rust state {embodiment}"] = lambda ours=ours: ours.ask("state", task)
        columns[f"main thread % {embodiment}"] = Python(task, embodiment).main_thread
    shipped, tuned = MetaWorld(task), MetaWorld(task, tuned=True)
    columns["MW image"] = lambda: shipped.ask(image)
    columns["MW tuned"] = lambda: tuned.ask(image)
    columns["EnvPool, no pictures"] = EnvPool(task, threads=1).state
    return columns


def main():
    driver, rounds = sys.argv[1], int(sys.argv[2])
    columns = {task: medians(measures(driver, task), rounds) for task in TASKS}
    print(f"medians of {rounds} rounds; control steps per second, with a picture each unless it says state or no pictures")
    print(" " * 22 + "".join(f"{name:>14}" for name in TASKS))
    for name in columns["goal-reach"]:
        print(f"{name:<22}" + "".join(f"{columns[task][name]:>14.1f}" for task in TASKS))


if __name__ == "__main__":
    main()
