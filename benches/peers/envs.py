"""Times our environments, EnvPool's and Meta-World's in turn and prints one table: envs.py DRIVER EMBODIMENT ROUNDS.

Everybody gets uniformly random actions, one a control step of 12.5 ms. Figures are medians over rounds; a round asks everybody once.
"""

import multiprocessing
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from statistics import median

import envpool
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS

TASKS = {  # ours: EnvPool's, Meta-World's
    "goal-reach": ("Reach", "reach-v3"),
    "button-press": ("ButtonPress", "button-press-v3"),
    "drawer-close": ("DrawerClose", "drawer-close-v3"),
    "plate-slide": ("PlateSlide", "plate-slide-v3"),
    "window-open": ("WindowOpen", "window-open-v3"),
    "window-close": ("WindowClose", "window-close-v3"),
    "door-open": ("DoorOpen", "door-open-v3"),
    "door-close": ("DoorClose", "door-close-v3"),
    "drawer-open": ("DrawerOpen", "drawer-open-v3"),
    "button-press-topdown": ("ButtonPressTopdown", "button-press-topdown-v3"),
    "faucet-close": ("FaucetClose", "faucet-close-v3"),
    "push": ("Push", "push-v3"),
    "pick-place": ("PickPlace", "pick-place-v3"),
    "peg-insert-side": ("PegInsertSide", "peg-insert-side-v3"),
}
TURN = 0.4  # seconds
ENVS = 16  # environments that take turns on a thread
MANY = 64  # environments whose memory is asked for
SIZE = 64  # pixels along a picture's side


def rate(run, most):
    """Runs per second over a turn of at most so many runs."""
    start, runs = time.perf_counter(), 0
    while runs < most and time.perf_counter() - start < TURN:
        run()
        runs += 1
    return runs / (time.perf_counter() - start)


class Ours:
    def __init__(self, driver, embodiment):
        self.driver, self.embodiment = driver, embodiment
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([driver], stdin=pipe, stdout=pipe, text=True)

    def ask(self, measure, task, threads=1):
        print(measure, self.embodiment, task, threads, file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())

    def memory(self, task):
        line = f"memory {self.embodiment} {task} 2\n"
        return float(subprocess.run([self.driver], input=line, capture_output=True, text=True, check=True).stdout)


class EnvPool:
    def __init__(self, task, threads):
        n = ENVS * threads
        name = f"MetaWorld/{TASKS[task][0]}-v3"
        self.pool = envpool.make(name, env_type="gymnasium", num_envs=n, batch_size=n, num_threads=threads)
        self.rng, self.n = np.random.default_rng(0), n

    def state(self):
        self.pool.reset()  # 500 engine steps, which ours need not repeat and which do not count here
        low = np.full((self.n, 4), -1, np.float32)
        return self.n * rate(lambda: self.pool.step(self.rng.uniform(low, 1).astype(np.float32)), 490)


class MetaWorld:
    """An environment in a process of its own: two renderers of one process take each other's OpenGL context."""

    def __init__(self, task, tuned=False):
        spawn = multiprocessing.get_context("spawn")
        self.process = ProcessPoolExecutor(1, spawn, initializer=make_env, initargs=(task, tuned))

    def ask(self, measure):
        return self.process.submit(measure).result()


def make_env(task, tuned):
    global env, rng
    make = ALL_V3_ENVIRONMENTS[TASKS[task][1]]
    env = make(render_mode="rgb_array", camera_name="topview", height=SIZE, width=SIZE)
    env._freeze_rand_vec, env._set_task_called, env._partially_observable = False, True, False
    rng = np.random.default_rng(0)
    if tuned:
        env.model.vis.quality.shadowsize = 0
        env.model.vis.quality.offsamples = 0
        env.model.mat_reflectance[:] = 0
    env.reset()
    env.render()


def step():
    env.step(rng.uniform(-1, 1, 4).astype(np.float32))


def picture():
    step()
    assert env.render().shape == (SIZE, SIZE, 3)


def state():
    env.reset()
    return rate(step, 490)


def image():
    env.reset()
    return rate(picture, 490)


def reset():
    return 1e3 / rate(env.reset, 490)


def measures(ours, task):
    """Name of every column and what measures it."""
    pools = [EnvPool(task, threads) for threads in (1, 2)]
    shipped, tuned = MetaWorld(task), MetaWorld(task, tuned=True)
    return {
        "state 1": lambda: ours.ask("state", task),
        "ceiling": lambda: ours.ask("ceiling", task),
        "EnvPool 1": pools[0].state,
        "state 2": lambda: ours.ask("state", task, 2),
        "EnvPool 2": pools[1].state,
        "MW state": lambda: shipped.ask(state),
        "image 1": lambda: ours.ask("image", task),
        "image 2": lambda: ours.ask("image", task, 2),
        "MW image": lambda: shipped.ask(image),
        "MW tuned": lambda: tuned.ask(image),
        "frame ms": lambda: ours.ask("frame", task),
        "reset ms": lambda: ours.ask("reset", task),
        "switch ms": lambda: ours.ask("switch", task),
        "MW reset ms": lambda: shipped.ask(reset),
    }


def medians(columns, rounds):
    """Asks every column's measure once a round."""
    figures = {name: [] for name in columns}
    for _ in range(rounds):
        for name, measure in columns.items():
            figures[name].append(measure())
    return {name: median(values) for name, values in figures.items()}


def number(value):
    return f"{value:.4f}" if value < 1 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def main():
    ours, count = Ours(sys.argv[1], sys.argv[2]), int(sys.argv[3])
    columns = {task: medians(measures(ours, task), count) for task in TASKS}
    print(f"ours: {sys.argv[2]}; medians of {count} rounds; control steps per second unless it says ms")
    print("".join(f"{name:>22}" for name in ["", *TASKS]))
    for name in next(iter(columns.values())):
        print(f"{name:<22}" + "".join(f"{number(columns[task][name]):>22}" for task in TASKS))
    ratios = {
        "/ EnvPool 1": ("state 1", "EnvPool 1"),
        "/ EnvPool 2": ("state 2", "EnvPool 2"),
        "/ ceiling": ("state 1", "ceiling"),
        "image / MW": ("image 1", "MW image"),
        "image / tuned": ("image 1", "MW tuned"),
    }
    for name, (above, below) in ratios.items():
        values = [columns[task][above] / columns[task][below] for task in TASKS]
        print(f"{name:<22}" + "".join(f"{value:>22.2f}" for value in values))
    memory = [ours.memory(task) for task in TASKS]
    print(f"{f'{MANY} envs MB':<22}" + "".join(f"{value:>22.0f}" for value in memory))


if __name__ == "__main__":
    main()
