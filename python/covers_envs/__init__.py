"""Table-top tasks of COVERS as Gymnasium environments: fourteen groups of four tasks, with a camera above the table.

    import covers_envs
    env = covers_envs.make_vec("button-press", num_envs=16, seed=0)

Importing the package registers `covers/GoalReach-v0` and one name for each other task with Gymnasium.
"""

from typing import Any

import gymnasium

from covers_envs._core import task_names, task_sets
from covers_envs.benchmarks import FixedGoalsEnv, make_mt1, make_mt10
from covers_envs.mixed import MixedVectorEnv
from covers_envs.policy import OnnxPolicy, policy_settings
from covers_envs.single import CoversEnv
from covers_envs.symmetry import SymmetryReport, Violation, check_symmetry
from covers_envs.training import RunPolicy, resume, run_settings, train
from covers_envs.vector import CoversVectorEnv

__all__ = [
    "TASKS",
    "TASK_SETS",
    "CoversEnv",
    "CoversVectorEnv",
    "FixedGoalsEnv",
    "MixedVectorEnv",
    "OnnxPolicy",
    "RunPolicy",
    "SymmetryReport",
    "Violation",
    "check_symmetry",
    "make",
    "make_mt1",
    "make_mt10",
    "make_vec",
    "policy_settings",
    "resume",
    "run_settings",
    "train",
]

#: Names of the groups, each of which draws a variant for every episode, then of their variants.
TASKS: tuple[str, ...] = tuple(task_names())

#: Names of the groups of each set: `standard`, `ten`, `mt10` and `all`.
TASK_SETS: dict[str, tuple[str, ...]] = {name: tuple(groups) for name, groups in task_sets()}


def make_vec(
    task: str | list[str] = "goal-reach", num_envs: int = 1, **settings: Any
) -> CoversVectorEnv | MixedVectorEnv:
    """Creates environments that are stepped together. `CoversVectorEnv` documents the settings. With tasks of several
    groups, the environments have the tasks in turn (`MixedVectorEnv`)."""
    if not isinstance(task, str) and len(set(map(_group, task))) > 1:
        return MixedVectorEnv(task, num_envs, **settings)
    return CoversVectorEnv(task, num_envs, **settings)


def _group(task: str) -> int:
    """Returns the index of a task's group; names of groups come first in `TASKS`, then four variants of each."""
    groups, index = len(TASK_SETS["all"]), TASKS.index(task) if task in TASKS else -1
    return index if index < groups else (index - groups) // 4


def make(task: str | list[str] = "goal-reach", **settings: Any) -> CoversEnv:
    """Creates one environment. `CoversVectorEnv` documents the settings."""
    return CoversEnv(task, **settings)


def _register() -> None:
    for task in TASKS:
        name = "".join(word.capitalize() for word in task.split("-"))
        gymnasium.register(
            id=f"covers/{name}-v0",
            entry_point="covers_envs.single:CoversEnv",
            vector_entry_point="covers_envs.vector:CoversVectorEnv",
            kwargs={"task": task},
        )


_register()
