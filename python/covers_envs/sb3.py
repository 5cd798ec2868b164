"""Adapter to the vector environments of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from covers_envs.vector import CoversVectorEnv


class SB3VecEnv(VecEnv):
    """Vector environment of Stable-Baselines3 around a `CoversVectorEnv`.

    `infos[i]["is_success"]` is True if the episode has succeeded so far, from which
    Stable-Baselines3 logs the success rate.

    Args:
        env: Environments made with `autoreset_mode="SameStep"`, and not with `copy=False`, because
            Stable-Baselines3 stores an observation after the step that follows it.
        only: Part of the observation to return, `image`, `vector` or `state`; None returns both.
    """

    def __init__(self, env: CoversVectorEnv, only: str | None = None) -> None:
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {env.autoreset_mode}, expected AutoresetMode.SAME_STEP")
        if not env.copies:
            raise ValueError(
                "the environments were made with `copy=False`, expected `copy=True`: Stable-Baselines3 stores "
                "an observation after the next step, which would have overwritten it"
            )
        known = list(env.single_observation_space)
        if only is not None and only not in known:
            raise ValueError(f"`only` is {only!r}, expected None or one of {', '.join(known)}")
        self.env = env
        self._only = only
        super().__init__(env.num_envs, self._shown(env.single_observation_space), env.single_action_space)
        self._succeeded = np.zeros(env.num_envs, np.bool_)

    def _shown(self, parts: Any) -> Any:
        return parts if self._only is None else parts[self._only]

    def reset(self) -> Any:
        """Begins episodes with the first of the seeds that `seed` set, and returns observations."""
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._succeeded[:] = False
        return self._shown(observation)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keeps the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Takes one decision in every environment."""
        observation, rewards, _, dones, infos = self.env.step(self._actions)
        self._succeeded |= infos["success"]
        per_env = [{"is_success": bool(success)} for success in self._succeeded]
        for index in np.flatnonzero(dones):
            last = self._shown(infos["final_obs"][index])
            per_env[index] |= {"terminal_observation": last, "TimeLimit.truncated": True}
        self._succeeded &= ~dones
        return self._shown(observation), rewards, dones, per_env

    def close(self) -> None:
        """Ends the worker threads."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Returns the current images."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns the attribute, which all environments share, once for each index."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises NotImplementedError: environments have no attributes of their own."""
        raise NotImplementedError(f"`{attr_name}` cannot be set: the environments live in one native vector")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Calls `expert_actions`; raises NotImplementedError for others: environments have no methods of their own."""
        if method_name == "expert_actions":
            actions = self.env.expert_actions()
            return [actions[index] for index in self._get_indices(indices)]
        raise NotImplementedError(f"`{method_name}` cannot be called: the environments live in one native vector")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Returns False for each index: no environment is wrapped."""
        return [False for _ in self._get_indices(indices)]
