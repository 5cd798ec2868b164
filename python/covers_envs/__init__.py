"""Table-top tasks of COVERS as Gymnasium environments: sixteen tasks with a camera above the table.

    import covers_envs
    env = covers_envs.make_vec("button-press", num_envs=16, seed=0)

Importing the package registers `covers/GoalReach-v0` and one name for each other task with Gymnasium.
"""

from typing import Any

import gymnasium

from covers_envs._core import task_names
from covers_envs.policy import OnnxPolicy, policy_settings
from covers_envs.single import CoversEnv
from covers_envs.vector import CoversVectorEnv

__all__ = ["TASKS", "CoversEnv", "CoversVectorEnv", "OnnxPolicy", "make", "make_vec", "policy_settings"]

#: Names of the four groups, each of which draws a variant for every episode, then of the sixteen variants.
TASKS: tuple[str, ...] = tuple(task_names())


def make_vec(task: str | list[str] = "goal-reach", num_envs: int = 1, **settings: Any) -> CoversVectorEnv:
    """Creates environments that are stepped together. `CoversVectorEnv` documents the settings."""
    return CoversVectorEnv(task, num_envs, **settings)


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
