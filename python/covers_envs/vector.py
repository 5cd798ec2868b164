"""Vector environment: environments that are stepped together."""

import contextlib
import difflib
import importlib
import json
import operator
import os
import warnings
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

#: Codes of `Core.advance`, one for each environment.
_STEP, _STEP_NO_AUTORESET, _RESET, _REST = range(4)
#: Names of the images that may follow the current one in an observation.
_EXTRA_IMAGES = ("first", "close_up", "first_and_close_up")
#: Shortest side of an image that `render` returns, in pixels.
_RENDERED = 480


class CoversVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Vector environment of N environments of one task group.

    Observations: `image`, uint8 `[N, size, size, C]`, the current image and the extra images;
    `vector`, float32 `[N, 7]`, hand x, y, z (metres from the table's centre), aperture, goal x, y,
    z (given in Goal Reach and Pick Place, zero elsewhere). Actions: float32 `[N, 4]` in [-1, 1]. Rewards are in
    [0, 1]. Episodes end by truncation alone.

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
        layout: `symmetric`, or `metaworld` for Meta-World's own dimensions and control.
        embodiment: `sawyer`, `hand` or `kinova_gen3`.
        seed: Seed of all random numbers; drawn at random if None. Environment i has a stream of its
            own, so nothing depends on `num_envs` or `threads`.
        threads: Number of worker threads; that of the available cores, at most N, if None.
        autoreset_mode: Behaviour at the end of an episode, see Gymnasium.
        copy: If True, every step returns new arrays. If False, all steps return the same arrays,
            which the next `reset` or `step` overwrites. `SB3VecEnv` and `CoversEnv` refuse False.
        render_mode: None or `rgb_array`.
        action_repeat: Number of control steps of 12.5 ms that an action is held for.
        displacement: Distance in metres that a full action moves the hand's target by.
        horizon: Number of control steps in an episode.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 8}

    def __init__(
        self,
        task: str | list[str] = "goal-reach",
        num_envs: int = 1,
        *,
        image_size: int | None = None,
        extra_images: str | None = None,
        camera: dict[str, Any] | None = None,
        layout: str = "symmetric",
        embodiment: str = "sawyer",
        seed: int | None = None,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        action_repeat: int | None = None,
        displacement: float | None = None,
        horizon: int | None = None,
    ) -> None:
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}, expected None or 'rgb_array'")
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
            self._new_seed(seed),
            action_repeat=action_repeat,
            displacement=displacement,
            horizon=horizon,
        )
        #: Number of decisions in an episode.
        self.decisions: int = self._core.decisions()

        size = self.settings["camera"]["size"]
        image = Box(0, 255, (size, size, self._core.image_channels()), np.uint8)
        low = np.array([-1, -1, -1, 0, -1, -1, -1], np.float32)
        self.single_observation_space = Dict(image=image, vector=Box(low, 1, dtype=np.float32))
        self.single_action_space = Box(-1, 1, (_core.ACTION_DIM,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, n)
        self.action_space = batch_space(self.single_action_space, n)

        #: `True` if every step returns new arrays.
        self.copies = copy
        self._out = self._new_arrays()
        self._final = self._new_observation()
        self._ended = np.zeros(n, np.bool_)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that determine observations and the effect of actions: `layout`, `embodiment`, `camera`,
        `action_repeat`, `displacement` and `horizon`. `make_vec(task, **env.settings)` takes them."""
        return json.loads(self._core.settings())

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Begins episodes in all environments, or in those whose `options["reset_mask"]`, `[N]`, is True.

        Equal seeds give equal episodes. Environment i draws from stream i of the one seed.
        """
        mask = self._reset_mask(options)
        if seed is not None:
            if not mask.all():
                raise ValueError("`seed` is for all environments: give it without `reset_mask`")
            self._core.reseed(self._new_seed(seed))
        none = np.zeros(self.action_space.shape, np.float32)
        failures = self._advance(none, np.where(mask, _RESET, _REST))
        self._ended &= ~mask
        return self._out[0], _failed({}, failures, self.num_envs)

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """Takes one decision in every environment. In the mode `NEXT_STEP`, environments whose episode
        ended in the last step begin a new one instead."""
        actions, commands = self._checked(actions), self._commands()
        failures = self._advance(actions, commands)
        observation, (rewards, success, success_at_end, truncated) = self._out
        outcome = {"success": success, "success_at_end": success_at_end}
        infos = _masked(outcome, commands <= _STEP_NO_AUTORESET)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if truncated.any():
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

    def set_task(self, task: str | list[str]) -> None:
        """Switches all environments to another task. The next call must be `reset`."""
        self._core.set_tasks(_tasks(task))
        self._ended[:] = False

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Returns the current images, enlarged by a whole number to at least 480 pixels along a side; None without a
        render mode."""
        if self.render_mode is None:
            return None
        self._core.require_own_process()
        images = self._out[0]["image"][..., :3]
        factor = -(-_RENDERED // images.shape[1])
        return tuple(images.repeat(factor, axis=1).repeat(factor, axis=2))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the worker threads."""
        if hasattr(self, "_core"):
            self._core.close()

    def _new_seed(self, seed: int | None) -> int:
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
        elif isinstance(seed, (list, tuple)):
            raise ValueError("`seed` is a list, expected one whole number: environment i draws from stream i of it")
        self._np_random_seed = _natural("seed", seed)
        return self._np_random_seed

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
        for index, message in failures:
            warnings.warn(f"environment {index}: {message}", RuntimeWarning, stacklevel=3)
        return failures

    def _commands(self) -> NDArray[Any]:
        match self.autoreset_mode:
            case AutoresetMode.SAME_STEP:
                return np.full(self.num_envs, _STEP)
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
        final_info = {name: array & ended for name, array in outcome.items()}
        return _masked({"final_obs": final_obs, "final_info": _masked(final_info, ended)}, ended)

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
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
        if array.dtype not in (np.float32, np.float64):
            raise ValueError(f"`actions` is of {array.dtype}, expected float32, or float64 to be converted")
        return np.ascontiguousarray(array, np.float32)


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
