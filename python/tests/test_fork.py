"""A forked child of a process with live environments: it is told so, and nothing hangs or aborts."""

import os
import signal
import subprocess
import sys

import pytest

#: Seconds after which a program has hung.
LIMIT = 60

#: Calls each in the child: all are refused, by name.
REFUSED = """
import multiprocessing, os, sys, threading
import numpy as np
import covers_envs

def refused(env):
    zeros = np.zeros(env.action_space.shape, np.float32)
    expert = getattr(env, "expert_actions", None) or env.expert_action
    calls = [env.reset, lambda: env.reset(seed=1), lambda: env.step(zeros), env.render, expert]
    if hasattr(env, "set_task"):
        calls.append(lambda: env.set_task("drawer-close"))
    for call in calls:
        try:
            call()
        except RuntimeError as error:
            assert f"made in process {os.getppid()}, this is process {os.getpid()}" in str(error), error
            assert "make environments after the fork" in str(error), error
        else:
            raise AssertionError("it was not refused")

def status(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
"""

MAKE = {
    "single": "covers_envs.make('goal-reach', image_size=16, seed=0, render_mode='rgb_array')",
    "one thread": "covers_envs.make_vec('goal-reach', 3, threads=1, image_size=16, render_mode='rgb_array')",
    "three threads": "covers_envs.make_vec('goal-reach', 3, threads=3, image_size=16, render_mode='rgb_array')",
}


@pytest.fixture
def run(tmp_path):
    return lambda *parts: _run(parts, tmp_path)


def _run(parts, folder):
    """Runs a program in a group of processes that ends with it, and returns what it printed."""
    program = subprocess.Popen(
        [sys.executable, "-c", "\n".join(parts)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        cwd=folder,  # the sources' folder holds a package without its native part
    )
    try:
        said, _ = program.communicate(timeout=LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(program.pid, signal.SIGKILL)
        pytest.fail(f"it hangs after {program.communicate()[0]!r}")
    assert program.returncode == 0, said
    assert "panic" not in said, said
    return said


@pytest.mark.parametrize("end", ["env.close()", "del env", "sys.exit(0)", "env.close(); env.close(); del env"])
@pytest.mark.parametrize("make", MAKE.values(), ids=MAKE)
def test_a_forked_child_is_told_and_ends_as_usual(run, make, end):
    run(
        REFUSED,
        f"""
env = {make}
env.reset()
child = os.fork()
if child == 0:
    refused(env)
    {end}
    sys.exit(0)
assert status(child) == 0
env.step(np.zeros(env.action_space.shape, np.float32))
env.close()
""",
    )


@pytest.mark.parametrize("make", MAKE.values(), ids=MAKE)
def test_a_worker_of_multiprocessing_is_told(run, make):
    run(
        REFUSED,
        f"""
env = {make}
env.reset()
worker = multiprocessing.get_context("fork").Process(target=refused, args=(env,))
worker.start()
worker.join()
assert worker.exitcode == 0, worker.exitcode
env.step(np.zeros(env.action_space.shape, np.float32))
""",
    )


def test_a_child_forked_in_the_middle_of_a_step_is_told(run):
    run(
        REFUSED,
        f"""
env = {MAKE["three threads"]}
env.reset()
zeros, going = np.zeros((3, 4), np.float32), True

def step():
    while going:
        env.step(zeros)

thread = threading.Thread(target=step, daemon=True)
thread.start()
for _ in range(20):
    child = os.fork()
    if child == 0:
        refused(env)
        env.close()
        sys.exit(0)
    assert status(child) == 0
going = False
thread.join()
env.close()
""",
    )


def test_a_child_makes_environments_of_its_own(run):
    said = run(
        REFUSED,
        f"""
def trace(env):
    observation, _ = env.reset(seed=3)
    outcome = env.step(np.ones(env.action_space.shape, np.float32))
    return [observation["image"].tobytes(), outcome[0]["image"].tobytes(), outcome[1].tobytes()]

env = {MAKE["three threads"]}
expected = trace(env)
child = os.fork()
if child == 0:
    own = {MAKE["three threads"]}
    assert trace(own) == expected
    own.close()
    print("the same bytes")
    sys.exit(0)
assert status(child) == 0
""",
    )
    assert "the same bytes" in said
