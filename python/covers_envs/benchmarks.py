"""Meta-World's conventions MT1 and MT10: one task and ten, with fixed lists of goals."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv

from covers_envs._core import task_sets
from covers_envs.single import CoversEnv, first
from covers_envs.vector import Info, Observation, check_options

#: Number of goals in a list, as in Meta-World.
NUM_GOALS = 50
#: Names of the two lists of a seed, which share no goal.
SPLITS = ("train", "test")


class FixedGoalsEnv(CoversEnv):
    """Single environment whose episodes have the goals of a fixed list of 50, in Meta-World's own layout by default.

    A goal is the placement of the task's objects, and the variant where the layout has several.

    Args:
        task: Task of `CoversEnv`.
        split: `train`, or `test` for the list of other goals.
        goal_seed: Seed of the list. Equal ones give equal lists.
        settings: Settings of `CoversEnv`; `seed` is that of the order in which goals are drawn.
    """

    def __init__(
        self, task: str | list[str] = "goal-reach", *, split: str = "train", goal_seed: int = 0, **settings: Any
    ) -> None:
        if split not in SPLITS:
            raise ValueError(f"setting `split` is {split!r}, expected one of {', '.join(SPLITS)}")
        super().__init__(task, **{"layout": "metaworld"} | settings)
        gymnasium.Env.reset(self, seed=settings.get("seed"))
        draws = np.random.SeedSequence((goal_seed, SPLITS.index(split))).generate_state(NUM_GOALS, np.uint64)
        # the simulation draws placement and variant from the seed of an episode
        self._goals = [int(goal) for goal in draws]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Begins an episode with the goal `options["goal"]`, or with one that is drawn at random, and returns its
        first observation. `info["goal"]` is the goal's index in the list, 0 to 49."""
        # not that of `CoversEnv`, which would draw the next goal from the seed of this one
        check_options(options, "goal")
        gymnasium.Env.reset(self, seed=seed)
        goal = (options or {}).get("goal")
        if goal is None:
            goal = int(self.np_random.integers(NUM_GOALS))
        if goal not in range(NUM_GOALS):
            raise ValueError(f"option `goal` is {goal!r}, expected a whole number from 0 to {NUM_GOALS - 1}")
        observation, _ = self._vector.reset(seed=self._goals[goal])
        return first(observation), {"goal": goal}


def make_mt1(task: str = "goal-reach", *, split: str = "train", goal_seed: int = 0, **settings: Any) -> FixedGoalsEnv:
    """Creates an environment of one task as in Meta-World's MT1. `FixedGoalsEnv` documents the settings."""
    return FixedGoalsEnv(task, split=split, goal_seed=goal_seed, **settings)


def make_mt10(*, split: str = "train", goal_seed: int = 0, **settings: Any) -> SyncVectorEnv:
    """Creates ten environments, one of each task of Meta-World's MT10 in its order. `FixedGoalsEnv` documents the
    settings; the environments get the seeds `seed`, `seed` + 1, and so on."""

    def maker(index: int, task: str) -> Any:
        own = settings if settings.get("seed") is None else settings | {"seed": settings["seed"] + index}
        return lambda: FixedGoalsEnv(task, split=split, goal_seed=goal_seed, **own)

    return SyncVectorEnv([maker(index, task) for index, task in enumerate(dict(task_sets())["mt10"])])
