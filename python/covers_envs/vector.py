"""Vector environment: environments that are stepped together."""

import contextlib
import difflib
import importlib
import json
import operator
import os
import warnings
from collections.abc import Sequence
from copy import copy as copy_of
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from covers_envs import _core

# Mesa's software renderer would spread each small image over all cores, which costs more than it
# saves. Mesa reads the variable when the first renderer is created.
os.environ.setdefault("LP_NUM_THREADS", "0")

Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]
Seed = int | Sequence[int] | None

#: Codes of `Core.advance`, one for each environment.
_STEP, _STEP_NO_AUTORESET, _RESET, _REST = range(4)
#: Names of the images that may follow the current one in an observation.
_EXTRA_IMAGES = ("first", "close_up", "first_and_close_up")
#: Last of the details of a state: the terms of rewards.
_TERMS = ("approach_reward", "in_place_reward", "goal_distance")
#: Shortest side of an image that `render` returns, in pixels.
_RENDERED = 480


class CoversVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Vector environment of N environments of one task group.

    Observations: `image`, uint8 `[N, size, size, C]`, the current image and the extra images;
    `vector`, float32 `[N, 10]`, hand x, y, z (metres from the table's centre), aperture, goal
    x, y, z (given in Goal Reach and Pick Place, zero elsewhere), lead x, y, z (metres, from the hand
    to its target). Actions: float32 `[N, 4]` in [-1, 1]. Rewards are in [0, 1]. Episodes end by
    truncation alone.

    Args:
        task: `goal-reach` (each episode draws one of four variants), `goal-reach-flip-x` (that
            variant), or a list of variants of one group. `covers_envs.TASKS` holds the names.
        num_envs: N.
        image_size: Width and height of the image in pixels, an even number; 48 by default, unless
            `camera` sets it.
        extra_images: Images after the current one: `first`, the episode's first (C = 6, the
            default), `close_up`, the table under the hand at present (C = 6), or
            `first_and_close_up` (C = 9).
        camera: Fields that differ from those of the default camera, for instance
            `{"oversampling": 3}`, by the names of an exported `policy.json`. `image_size` and
            `extra_images` override its fields `size` and `beside`.
        randomisation: Fields that differ from those of the default domain randomisation of images,
            `{}` for all defaults; None for perfect images.
        state: If True, observations hold `state` and `infos` hold the terms of rewards. `state` is
            float32 `[N, 13]`: hand x, y, z, aperture, object x, y, z, its second point x, y, z (of a
            peg: the tip) and the goal x, y, z, in metres from the table's centre. The terms are
            `approach_reward`, `in_place_reward`, both in [0, 1], and `goal_distance` (metres).
        layout: `symmetric`, or `metaworld` for Meta-World's own dimensions and control.
        embodiment: `sawyer`, `hand` or `kinova_gen3`.
        seed: Seed of all random numbers; drawn at random if None. Environment i has a stream of its
            own, so nothing depends on `num_envs` or `threads`. In a list of seeds, each is that of
            one environment, whose episodes are then those of a single one with this seed.
        threads: Number of worker threads; that of the available cores, at most N, if None.
        autoreset_mode: Behaviour at the end of an episode, see Gymnasium.
        copy: If True, every step returns new arrays. If False, all steps return the same arrays,
            which the next `reset` or `step` overwrites. `SB3VecEnv` and `CoversEnv` refuse False.
        render_mode: None or `rgb_array`.
        render_camera: Camera of `render`: None for the observed images, `top`, or `corner`, from which
            one looks at the robot.
        render_arm: If True, `top` and `corner` show the arm.
        action_repeat: Number of control steps of 12.5 ms that an action is held for.
        displacement: Distance in metres that a full action moves the hand's target by.
        horizon: Number of control steps in an episode.
        max_episode_steps: Number of decisions in an episode, in place of `horizon`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 8}
    _spec: Any = None

    def __init__(
        self,
        task: str | list[str] = "goal-reach",
        num_envs: int = 1,
        *,
        image_size: int | None = None,
        extra_images: str | None = None,
        camera: dict[str, Any] | None = None,
        randomisation: dict[str, Any] | None = None,
        state: bool = False,
        layout: str = "symmetric",
        embodiment: str = "sawyer",
        seed: Seed = None,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        render_camera: str | None = None,
        render_arm: bool = True,
        action_repeat: int | None = None,
        displacement: float | None = None,
        horizon: int | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}, expected None or 'rgb_array'")
        if render_camera not in (None, "top", "corner"):
            raise ValueError(f"render_camera is {render_camera!r}, expected None, 'top' or 'corner'")
        self._view = render_camera, render_arm
        self.num_envs = n = _natural("num_envs", num_envs)
        if threads is None:
            threads = max(1, min(n, len(os.sched_getaffinity(0))))
        _load_other_compilers()
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._core = _core.Core(
            _tasks(task),
            n,
            _natural("threads", threads),
            json.dumps(_camera(camera, image_size, extra_images)),
            layout,
            embodiment,
            None if randomisation is None else json.dumps(randomisation),
            action_repeat=action_repeat,
            displacement=displacement,
            horizon=horizon,
            decisions=None if max_episode_steps is None else _natural("max_episode_steps", max_episode_steps),
        )
        self._reseed(drawn_seed() if seed is None else seed)
        #: Number of decisions in an episode.
        self.decisions: int = self._core.decisions()

        size = self.settings["camera"]["size"]
        image = Box(0, 255, (size, size, self._core.image_channels()), np.uint8)
        low = np.full(len(_core.vector_irreps()), -1, np.float32)
        low[3] = 0  # the aperture
        parts = {"image": image, "vector": Box(low, 1, dtype=np.float32)}
        #: Details of the states, `[N, 16]`; None without the setting `state`.
        self._details = np.zeros((n, _core.DETAILS_DIM), np.float32) if state else None
        if state:
            parts["state"] = Box(-np.inf, np.inf, (_core.DETAILS_DIM - len(_TERMS),), np.float32)
        self.single_observation_space = Dict(parts)
        self.single_action_space = Box(-1, 1, (_core.ACTION_DIM,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, n)
        self.action_space = batch_space(self.single_action_space, n)

        #: `True` if every step returns new arrays.
        self.copies = copy
        self._out = self._new_arrays()
        self._final = self._new_observation()
        self._ended = np.zeros(n, np.bool_)
        #: Copy of the current images for `render`, which callers cannot change.
        self._shown: NDArray[np.uint8] | None = None

    @property
    def spec(self) -> Any:
        """Gymnasium's specification, with the number of decisions in an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        self._spec = with_limit(spec, self.decisions)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that determine observations and the effect of actions: `layout`, `embodiment`, `camera`,
        `randomisation`, `action_repeat`, `displacement` and `horizon`. `make_vec(task, **env.settings)` takes them."""
        return json.loads(self._core.settings())

    def reset(self, *, seed: Seed = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Begins episodes in all environments, or in those whose `options["reset_mask"]`, `[N]`, is True.

        Equal seeds give equal episodes. Environment i draws from stream i of one seed, or has a seed of its own in a
        list.
        """
        mask = self._reset_mask(options)
        if seed is not None:
            if not mask.all():
                raise ValueError("`seed` is for all environments: give it without `reset_mask`")
            self._reseed(seed)
        failures = self._begin(mask)
        self._ended &= ~mask
        return self._out[0], _failed({}, failures, self.num_envs)

    def _begin(self, mask: NDArray[np.bool_]) -> list[tuple[int, str]]:
        none = np.zeros(self.action_space.shape, np.float32)
        return self._advance(none, np.where(mask, _RESET, _REST))

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Takes one decision in every environment. In the mode `NEXT_STEP`, environments whose episode
        ended in the last step begin a new one instead."""
        actions, commands = self._checked(actions), self._commands()
        failures = self._advance(actions, commands)
        observation, (rewards, success, success_at_end, truncated) = self._out
        outcome = {"success": success, "success_at_end": success_at_end}
        if self._details is not None:
            outcome |= {name: self._details[:, i].copy() for i, name in enumerate(_TERMS, -len(_TERMS))}
        infos = _masked(outcome, commands <= _STEP_NO_AUTORESET)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if truncated.any():
                if self._details is not None:
                    # the final states were read before the next episodes begin, here
                    self._final = {name: array.copy() for name, array in observation.items()}
                    rewards, truncated = rewards.copy(), truncated.copy()
                    infos = {name: array.copy() for name, array in infos.items()}
                    outcome = {name: infos[name] for name in outcome}
                    failures += self._begin(truncated)
                    observation = self._out[0]
                infos |= self._final_infos(outcome, truncated)
        else:
            self._ended = truncated.copy()
        terminated = np.zeros(self.num_envs, np.bool_)
        return observation, rewards, terminated, truncated, _failed(infos, failures, self.num_envs)

    def expert_actions(self) -> NDArray[np.float32]:
        """Returns the scripted experts' actions in the current states, `[N, 4]`."""
        actions = np.empty(self.action_space.shape, np.float32)
        self._core.expert_actions(actions)
        return actions

    def save_state(self) -> Any:
        """Returns the state of all running episodes, random numbers included, for `restore_state` in this process."""
        return self._core.save(), self._ended.copy()

    def restore_state(self, state: Any) -> Observation:
        """Restores a state of `save_state`, of environments with this task and these settings. Episodes then
        continue to the same bits. Returns the last observation before the state was saved."""
        episodes, ended = state
        out = self._new_arrays()[0] if self.copies else self._out[0]
        self._core.restore(episodes, out["image"], out["vector"])
        self._out = out, self._out[1]
        self._show()
        self._ended = ended.copy()
        return out

    def set_task(self, task: str | list[str]) -> None:
        """Switches all environments to another task. The next call must be `reset`."""
        self._core.set_tasks(_tasks(task))
        self._ended[:] = False

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Returns the current images, enlarged by a whole number to at least 480 pixels along a side, or those of
        `render_camera`, 480 pixels along a side; None without a render mode."""
        if self.render_mode is None:
            return None
        self._core.require_own_process()
        images = self._shown
        if images is None:
            raise RuntimeError("there is no image yet: call `reset` before `render`")
        camera, arm = self._view
        if camera is not None:
            pictures = np.empty((self.num_envs, _RENDERED, _RENDERED, 3), np.uint8)
            self._core.render(camera, arm, pictures)
            return tuple(pictures)
        factor = -(-_RENDERED // images.shape[1])
        return tuple(images.repeat(factor, axis=1).repeat(factor, axis=2))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the worker threads."""
        if hasattr(self, "_core"):
            self._core.close()

    def _reseed(self, seed: int | Sequence[int]) -> None:
        if isinstance(seed, (list, tuple, np.ndarray)):
            if len(seed) != self.num_envs:
                raise ValueError(f"`seed` is a list of {len(seed)}, expected {self.num_envs} whole numbers")
            self._core.reseed_each([_natural("seed", each) for each in seed])
            self._np_random_seed = tuple(seed)
        else:
            self._np_random_seed = _natural("seed", seed)
            self._core.reseed(self._np_random_seed)

    def _new_arrays(self) -> tuple[Observation, tuple[NDArray[Any], ...]]:
        n = self.num_envs
        outcome = np.empty(n, np.float32), *(np.empty(n, np.bool_) for _ in range(3))
        return self._new_observation(), outcome

    def _new_observation(self) -> Observation:
        return {name: np.zeros(space.shape, space.dtype) for name, space in self.observation_space.items()}

    def _advance(self, actions: NDArray[np.float32], commands: NDArray[Any]) -> list[tuple[int, str]]:
        """Advances the environments into new arrays, or with `copy=False` into those that all steps share."""
        # this check comes first: arrays that another thread's step borrows at a fork stay borrowed in
        # the child, and the error would be about that
        self._core.require_own_process()
        out = self._new_arrays() if self.copies else self._out
        (observation, outcome), final = out, self._final
        arrays = observation["image"], observation["vector"], final["image"], final["vector"], outcome
        failures = self._core.advance(actions, commands.astype(np.uint8), arrays)
        self._out = out
        self._show()
        for index, message in failures:
            warnings.warn(f"environment {index}: {message}", RuntimeWarning, stacklevel=3)
        return failures

    def _show(self) -> None:
        """Reads what the episodes' new states tell besides the observation."""
        observation = self._out[0]
        if self.render_mode is not None:
            self._shown = observation["image"][..., :3].copy()
        if self._details is not None:
            self._core.details(self._details)
            observation["state"][:] = self._details[:, : -len(_TERMS)]

    def _commands(self) -> NDArray[Any]:
        match self.autoreset_mode:
            case AutoresetMode.SAME_STEP:
                # with `state`, `step` begins episodes itself, after it has read the final states
                return np.full(self.num_envs, _STEP if self._details is None else _STEP_NO_AUTORESET)
            case AutoresetMode.NEXT_STEP:
                return np.where(self._ended, _RESET, _STEP_NO_AUTORESET)
        if self._ended.any():
            ended = np.flatnonzero(self._ended).tolist()
            raise RuntimeError(f"environments {ended}: no episode is running: call `reset` first")
        return np.full(self.num_envs, _STEP_NO_AUTORESET)

    def _final_infos(self, outcome: dict[str, NDArray[Any]], ended: NDArray[np.bool_]) -> Info:
        final_obs = np.full(self.num_envs, None, object)
        for index in np.flatnonzero(ended):
            rows = {name: array[index] for name, array in self._final.items()}
            final_obs[index] = {name: row.copy() for name, row in rows.items()} if self.copies else rows
        final_info = {name: np.where(ended, array, array.dtype.type(0)) for name, array in outcome.items()}
        return _masked({"final_obs": final_obs, "final_info": _masked(final_info, ended)}, ended)

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        check_options(options, "reset_mask")
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"`reset_mask` is {mask!r}, expected an array of {self.num_envs} booleans")
        return mask

    def _checked(self, actions: Any) -> NDArray[np.float32]:
        array = np.asarray(actions)
        if array.shape != self.action_space.shape:
            raise ValueError(f"`actions` has the shape {array.shape}, expected {self.action_space.shape}")
        if array.dtype.kind not in "fiu":
            raise ValueError(f"`actions` is of {array.dtype}, expected real numbers, such as float32")
        return np.ascontiguousarray(array, np.float32)


def with_limit(spec: Any, decisions: int) -> Any:
    """Returns a specification of Gymnasium with the number of decisions in an episode."""
    if spec is None:
        return None
    own = copy_of(spec)
    own.max_episode_steps = decisions
    return own


def check_options(options: dict[str, Any] | None, *known: str) -> None:
    """Raises ValueError for options of `reset` that are not known."""
    unknown = sorted(set(options or {}) - set(known))
    if unknown:
        raise ValueError(f"unknown options {unknown} of `reset`, expected of {list(known)}")


def drawn_seed() -> int:
    """Returns a random seed of 64 bits."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0])


def _load_other_compilers() -> None:
    """Loads Triton before Mesa. Mesa's driver makes the symbols of its LLVM global. Triton, which PyTorch loads when it
    first optimises, has an LLVM of its own, and the process crashes if Triton is loaded second."""
    with contextlib.suppress(Exception):
        importlib.import_module("triton")


def _camera(camera: dict[str, Any] | None, image_size: int | None, extra_images: str | None) -> dict[str, Any]:
    fields = dict(camera or {})
    if image_size is not None:
        fields["size"] = _natural("image_size", image_size)
    if extra_images is not None:
        if extra_images not in _EXTRA_IMAGES:
            known = ", ".join(_EXTRA_IMAGES)
            raise ValueError(f"setting `extra_images` is {extra_images!r}, expected one of {known}")
        fields["beside"] = extra_images
    return fields


def _masked(values: dict[str, Any], mask: NDArray[np.bool_]) -> Info:
    """Returns values, each with Gymnasium's mask of the environments that have one."""
    return values | {f"_{name}": mask.copy() for name in values}


def _failed(infos: Info, failures: list[tuple[int, str]], n: int) -> Info:
    """Returns infos with the error messages of environments that failed."""
    if not failures:
        return infos
    texts = np.full(n, None, object)
    for index, message in failures:
        texts[index] = message
    return infos | _masked({"failure": texts}, texts != None)  # noqa: E711


def _natural(name: str, value: Any) -> int:
    number = operator.index(value)
    if 0 <= number < 2**64:
        return number
    raise ValueError(f"setting `{name}` is {number}, expected a whole number of 64 bits")


def _tasks(task: str | list[str]) -> list[str]:
    names, known = [task] if isinstance(task, str) else list(task), _core.task_names()
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1, 0)
            raise ValueError(f"unknown task `{name}`, did you mean `{near[0]}`? `covers_envs.TASKS` holds the names")
    return names
