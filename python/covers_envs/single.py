"""Single environment for `gymnasium.make`."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from covers_envs.vector import CoversVectorEnv, Info, Observation, check_options, with_limit


class CoversEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Single environment of a task, with the settings of `CoversVectorEnv` except `copy`: every
    observation is a new one."""

    metadata: dict[str, Any] = CoversVectorEnv.metadata
    _spec: Any = None

    def __init__(self, task: str | list[str] = "goal-reach", **settings: Any) -> None:
        if not settings.get("copy", True):
            raise ValueError(
                "setting `copy` is False, expected True: a single environment's observations are kept over "
                "its next `step` or `reset`, for instance by Gymnasium's vectors; `make_vec` takes False"
            )
        for name in {"num_envs", "autoreset_mode"} & set(settings):
            raise ValueError(f"`{name}` is a setting of `make_vec`: `make` creates one environment, without autoreset")
        self._vector = CoversVectorEnv(task, 1, autoreset_mode=AutoresetMode.DISABLED, **settings)
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space
        self.render_mode = self._vector.render_mode

    @property
    def spec(self) -> Any:
        """Gymnasium's specification, with the number of decisions in an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        self._spec = with_limit(spec, self._vector.decisions)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the environment, see `CoversVectorEnv.settings`."""
        return self._vector.settings

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Begins an episode, and returns its first observation."""
        check_options(options)
        super().reset(seed=seed)
        observation, _ = self._vector.reset(seed=seed)
        return first(observation), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Takes one decision. An episode ends by truncation alone, never by termination."""
        observation, rewards, _, truncated, infos = self._vector.step(np.asarray(action)[None])
        info = {name: array[0] for name, array in infos.items() if not name.startswith("_")}
        return first(observation), float(rewards[0]), False, bool(truncated[0]), info

    def expert_action(self) -> NDArray[np.float32]:
        """Returns the scripted expert's action in the current state, `[4]`."""
        return self._vector.expert_actions()[0]

    def save_state(self) -> Any:
        """Returns the state of the running episode, see `CoversVectorEnv.save_state`."""
        return self._vector.save_state()

    def restore_state(self, state: Any) -> Observation:
        """Restores a state of `save_state`, and returns its observation."""
        return first(self._vector.restore_state(state))

    def render(self) -> NDArray[np.uint8] | None:
        """Returns the current image, enlarged; None without a render mode."""
        pictures = self._vector.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Ends the worker thread."""
        self._vector.close()


def first(observation: Observation) -> Observation:
    """Returns the observation of a vector's first environment."""
    return {name: array[0] for name, array in observation.items()}
