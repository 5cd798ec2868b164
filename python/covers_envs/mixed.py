"""Vector environment whose environments have tasks of several groups."""

import operator
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from covers_envs.vector import CoversVectorEnv, Info, Observation, Seed, check_options, drawn_seed


class MixedVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Vector environment of N environments that have the `tasks` in turn: environment i has task i modulo their number.

    Environment i has the seed `seed + i`, and episodes like those of a single environment with this seed.

    Args:
        tasks: Names of tasks or groups.
        num_envs: N, at least the number of tasks.
        seed: Seed of all random numbers, or a list of one for each environment; drawn at random if None.
        settings: Settings of `CoversVectorEnv`.
    """

    def __init__(self, tasks: list[str], num_envs: int, *, seed: Seed = None, **settings: Any) -> None:
        if num_envs < len(tasks):
            raise ValueError(f"setting `num_envs` is {num_envs}, expected at least {len(tasks)}, one for each task")
        self.num_envs = num_envs
        #: Indices of the environments of each part.
        self._rows = [np.arange(start, num_envs, len(tasks)) for start in range(len(tasks))]
        seeds = self._seeds(drawn_seed() % 2**63 if seed is None else seed)
        self.parts = [
            CoversVectorEnv(task, len(rows), seed=[seeds[row] for row in rows], **settings)
            for task, rows in zip(tasks, self._rows, strict=True)
        ]
        first = self.parts[0]
        self.tasks, self.decisions, self.copies = tuple(tasks), first.decisions, first.copies
        self.autoreset_mode, self.metadata, self.render_mode = first.autoreset_mode, first.metadata, first.render_mode
        self.single_observation_space, self.single_action_space = (
            first.single_observation_space,
            first.single_action_space,
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the environments, see `CoversVectorEnv.settings`."""
        return self.parts[0].settings

    def reset(self, *, seed: Seed = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Begins episodes, see `CoversVectorEnv.reset`. Environment i has the seed `seed + i`."""
        check_options(options, "reset_mask")
        mask, seeds = (options or {}).get("reset_mask"), None if seed is None else self._seeds(seed)
        # before any part is reset
        if mask is not None:
            if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
                raise ValueError(f"`reset_mask` is {mask!r}, expected an array of {self.num_envs} booleans")
            if seeds is not None and not mask.all():
                raise ValueError("`seed` is for all environments: give it without `reset_mask`")
        shown = [
            part.reset(
                seed=None if seeds is None else [seeds[row] for row in rows],
                options=None if mask is None else {"reset_mask": mask[rows]},
            )
            for part, rows in zip(self.parts, self._rows, strict=True)
        ]
        observations, infos = zip(*shown, strict=True)
        return self._joined(observations), self._joined(infos)

    def step(self, actions: NDArray[np.float32]) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Takes one decision in every environment, see `CoversVectorEnv.step`."""
        actions = np.asarray(actions)
        if actions.shape != self.action_space.shape:
            raise ValueError(f"`actions` has the shape {actions.shape}, expected {self.action_space.shape}")
        if not np.isfinite(actions).all():
            raise ValueError("`actions` holds a number that is not finite, expected numbers in [-1, 1]")
        steps = [part.step(actions[rows]) for part, rows in zip(self.parts, self._rows, strict=True)]
        observations, *outcomes, infos = zip(*steps, strict=True)
        rewards, terminated, truncated = (self._joined([{"": each} for each in parts])[""] for parts in outcomes)
        return self._joined(observations), rewards, terminated, truncated, self._joined(infos)

    def expert_actions(self) -> NDArray[np.float32]:
        """Returns the scripted experts' actions in the current states, `[N, 4]`."""
        return self._joined([{"": part.expert_actions()} for part in self.parts])[""]

    def save_state(self) -> Any:
        """Returns the state of all running episodes, see `CoversVectorEnv.save_state`."""
        return [part.save_state() for part in self.parts]

    def restore_state(self, state: Any) -> Observation:
        """Restores a state of `save_state`, and returns its observation."""
        shown = [part.restore_state(each) for part, each in zip(self.parts, state, strict=True)]
        return self._joined(shown)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Returns the current images, see `CoversVectorEnv.render`."""
        if self.render_mode is None:
            return None
        images = [part.render() for part in self.parts]
        return tuple(images[row % len(images)][row // len(images)] for row in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the worker threads."""
        for part in getattr(self, "parts", []):
            part.close()

    def _seeds(self, seed: Seed) -> list[int]:
        if not isinstance(seed, (list, tuple, np.ndarray)):
            return [operator.index(seed) + row for row in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"`seed` is a list of {len(seed)}, expected {self.num_envs} whole numbers")
        return list(seed)

    def _joined(self, parts: Any) -> dict[str, Any]:
        """Joins the arrays of all parts by name. Where a part has none, it is zero, or None for objects."""
        joined: dict[str, Any] = {}
        for name in dict.fromkeys(name for part in parts for name in part):
            values = [part.get(name) for part in parts]
            present = next(value for value in values if value is not None)
            if isinstance(present, dict):
                joined[name] = self._joined([value or {} for value in values])
                continue
            whole = np.zeros((self.num_envs, *present.shape[1:]), present.dtype)
            if present.dtype == object:
                whole[:] = None
            for rows, value in zip(self._rows, values, strict=True):
                if value is not None:
                    whole[rows] = value
            joined[name] = whole
        return joined
