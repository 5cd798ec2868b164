"""Check of the symmetries of environments, for any environment of Gymnasium."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete, flatten
from numpy.typing import NDArray

from covers_envs import _core
from covers_envs.single import CoversEnv

#: Names of the irreps; the bits of an index say whether flips of x and of y change the sign.
_IRREPS = ("1", "x", "y", "xy")
#: Elements of the groups: the bits are flips of x and of y. The identity comes first.
_ELEMENTS = {"D2": (0, 1, 2, 3), "D1x": (0, 1), "D1y": (0, 2), "C2": (0, 3)}
_HADAMARD = np.array([[-1.0 if (i & j).bit_count() % 2 else 1.0 for i in range(4)] for j in range(4)])
#: Number of randomly transformed copies of all episodes, and of episodes that the test needs.
_RANDOMISATIONS, _MIN_EPISODES = 999, 48
#: Number of rollouts that are repeated for `SymmetryReport.noise`.
_REPEATED = 3


@dataclass(frozen=True)
class Violation:
    """Quantity whose mean contradicts the declared irreps."""

    #: Product of components of vector and action, moments of the image, their changes, and the reward.
    quantity: str
    #: Irrep by which the quantity would change its sign: `x`, `y` or `xy`.
    irrep: str
    #: Mean over episodes of the quantity's sum, which would be 0.
    mean: float
    #: Magnitude of the mean in standard errors, its noise between episodes.
    deviation: float


@dataclass(frozen=True)
class SymmetryReport:
    """Result of `check_symmetry`."""

    #: Violations, the most significant first.
    violations: tuple[Violation, ...]
    #: Largest differences between identical rollouts (equal seeds and actions) of `vector`, of moments of the `image`
    #: and of `reward`; all are 0 where an environment can be replayed.
    noise: dict[str, float]

    @property
    def ok(self) -> bool:
        """True if no symmetry is violated."""
        return not self.violations

    def __str__(self) -> str:
        noise = ", ".join(f"{name} {value:g}" for name, value in self.noise.items())
        lines = [
            f"{each.quantity}: mean {each.mean:g}, expected 0 by the irrep {each.irrep}, "
            f"{each.deviation:.1f} standard errors away"
            for each in self.violations
        ]
        return "\n".join([*(lines or ["no violation"]), f"noise between identical rollouts: {noise}"])


def check_symmetry(
    env: gymnasium.Env,
    *,
    vector: Sequence[str] | None = None,
    action: Sequence[str] | None = None,
    image: str | None = None,
    group: str = "D2",
    episodes: int = 200,
    max_steps: int = 50,
    seed: int = 0,
) -> SymmetryReport:
    """Runs random actions and reports quantities that contradict the symmetries of observations, actions and rewards.

    If a flip of x moves the environment's distribution of episodes onto itself, the mean of everything that
    changes its sign under the flip is zero. An environment without faults is reported in at most 1 of 1000 checks.
    First states must be distributed symmetrically.

        pendulum = gymnasium.make("Pendulum-v1")
        report = covers_envs.check_symmetry(pendulum, vector=["1", "x", "x"], action=["x"], group="D1x")
        assert report.ok, report

    Args:
        env: Environment that `reset(seed=...)` restarts.
        vector: Irrep of each component of the flattened observation without the image: `x` for one that changes its
            sign under a flip of x, `y`, `xy`, or `1` for one that never does. Those of `CoversEnv` are known.
        action: Irrep of each component of a continuous action. For choices of a discrete one: `["1"]` for a choice
            that flips leave alone, `["1", "x"]` for two that a flip of x exchanges, such as left and right, and
            `["1", "x", "y", "xy"]` for four; one group after the other, in the order of the choices.
        image: Name of the image, uint8 `[H, W, C]`, in an observation that is a dictionary; `""` if the observation is
            the image. Row 0 is the largest y, column 0 the smallest x.
        group: Symmetry to check: `D2`, `D1x` (flips of x), `D1y` or `C2` (half turns).
        episodes: Number of episodes, at least 48. Some hundred find small violations.
        max_steps: Number of steps after which an episode is cut off.
        seed: Seed from which the seeds of all episodes are drawn, of first states and of actions.
    """
    if isinstance(env.unwrapped, CoversEnv):
        vector = vector or [_IRREPS[index] for index in _core.vector_irreps()]
        action = action or [_IRREPS[index] for index in _core.action_irreps()]
        image = "image" if image is None else image
    if action is None:
        raise ValueError("`action` is None, expected the irreps of the action's components")
    replayed = _Replayed(env, image, max_steps, list(vector or []), list(action))
    rng = np.random.default_rng(seed)
    seeds = [int(each) for each in rng.integers(2**31, size=episodes)]
    rollouts = [replayed.rollout(each) for each in seeds]
    noise = {"vector": 0.0, "image": 0.0, "reward": 0.0}
    for each, first in zip(seeds[:_REPEATED], rollouts, strict=False):
        second = replayed.rollout(each)
        for name, largest in noise.items():
            pairs = zip(getattr(first, name), getattr(second, name), strict=False)
            noise[name] = max([largest, *(float(np.abs(a - b).max(initial=0)) for a, b in pairs)])
    return SymmetryReport(tuple(_violations(replayed, rollouts, group, rng)), noise)


@dataclass(frozen=True)
class _Rollout:
    """One episode of T steps."""

    #: Vectors `[T + 1, D]`.
    vector: NDArray[np.float64]
    #: Moments 1, x, y and xy of each channel of the images, `[T + 1, 4 C]`.
    image: NDArray[np.float64]
    #: Components of the actions in the basis of their irreps, `[T, A]`.
    action: NDArray[np.float64]
    #: Rewards `[T]`.
    reward: NDArray[np.float64]


def _violations(env: "_Replayed", rollouts: list[_Rollout], group: str, rng: np.random.Generator) -> list[Violation]:
    """Compares the mean of each quantity that changes its sign with those of the same episodes, each transformed by a
    random element of the group: the randomisation test of `rl::check_env_symmetry`."""
    if len(rollouts) < _MIN_EPISODES:
        raise ValueError(f"`episodes` is {len(rollouts)}, expected at least {_MIN_EPISODES}")
    if group not in _ELEMENTS:
        raise ValueError(f"`group` is {group!r}, expected one of {', '.join(_ELEMENTS)}")
    elements = np.array(_ELEMENTS[group])
    names, irreps = env.quantities()
    # signs of each irrep, as bits, under each element
    signs = np.array([[-1.0 if (irrep & g).bit_count() % 2 else 1.0 for g in elements] for irrep in range(4)])
    acts = (signs < 0).any(axis=1)
    tested = np.flatnonzero(acts[irreps])
    sums = env.centred_sums(rollouts, acts)[:, tested]
    irreps, norms = irreps[tested], np.linalg.norm(sums, axis=0)
    columns = [np.flatnonzero(irreps == irrep) for irrep in range(4)]

    def ratios(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
        total = np.zeros(len(tested))
        for irrep, own in enumerate(columns):
            total[own] = signs[irrep, drawn] @ sums[:, own]
        return np.divide(total, norms, out=np.zeros_like(total), where=norms > 0)

    observed = ratios(np.zeros(len(rollouts), np.int64))
    draws = (rng.integers(len(elements), size=len(rollouts)) for _ in range(_RANDOMISATIONS))
    largest = max(np.abs(ratios(drawn)).max(initial=0) for drawn in draws)
    found = [
        Violation(names[tested[k]], _IRREPS[irreps[k]], float(sums[:, k].mean()), float(abs(observed[k])))
        for k in np.flatnonzero(np.abs(observed) > largest * (1 + 1e-9))
    ]
    return sorted(found, key=lambda each: -each.deviation)


class _Replayed:
    """Environment with episodes that a seed determines, whose observations are split and measured."""

    def __init__(
        self, env: gymnasium.Env, image: str | None, max_steps: int, vector: list[str], action: list[str]
    ) -> None:
        self._env, self._image, self._max_steps = env, image, max_steps
        space, actions = env.observation_space, env.action_space
        self._weights, channels = None, 0
        if image is not None:
            space = space[image] if image else space
            if not (isinstance(space, Box) and space.dtype == np.uint8 and len(space.shape) == 3):
                raise ValueError(f"the image {image!r} is of {space}, expected a Box of uint8 [H, W, C]")
            height, width, channels = space.shape
            # in half pixels: whole numbers, so that sums are exact and a moment that does not change has no change by
            # rounding, either
            x, y = 2.0 * np.arange(width) + 1 - width, height - 2.0 * np.arange(height) - 1
            ones = np.ones((height, width))
            self._weights = np.array([ones, ones * x, ones * y[:, None], x * y[:, None]])
            self._units = 255.0 * height * width * np.array([1, width, height, width * height])
        if not isinstance(actions, (Box, Discrete, MultiDiscrete)):
            raise ValueError(f"actions are of {actions}, expected Box, Discrete or MultiDiscrete")
        if isinstance(actions, MultiDiscrete) and actions.nvec.ndim != 1:
            raise ValueError(f"actions are of {actions}, expected one dimension")
        discrete = [actions.n] if isinstance(actions, Discrete) else getattr(actions, "nvec", [])
        #: Numbers of choices of discrete actions; empty for continuous ones.
        self._choices = [int(each) for each in discrete]
        width = sum(self._choices) or int(np.prod(actions.shape))
        shown = self._split(env.reset(seed=0)[0])[0].size
        for what, given, expected in (("vector", vector, shown), ("action", action, width)):
            unknown = [each for each in given if each not in _IRREPS]
            if unknown:
                raise ValueError(f"`{what}` has the irrep {unknown[0]!r}, expected 1, x, y or xy")
            if len(given) != expected:
                raise ValueError(f"`{what}` has {len(given)} irreps, expected {expected}")
        self._actions = np.array([_IRREPS.index(each) for each in action])
        self._features = np.array([_IRREPS.index(each) for each in vector] + [0, 1, 2, 3] * channels, np.int64)
        self._names = [f"vector component {i} ({irrep})" for i, irrep in enumerate(vector)]
        self._names += [f"moment {irrep} of channel {c} of the image" for c in range(channels) for irrep in _IRREPS]

    def rollout(self, seed: int) -> _Rollout:
        """Runs random actions from the first state of a seed."""
        # not `default_rng(seed)`, from which an environment with this seed draws its first state
        rng, observation = np.random.default_rng((seed, 1)), self._env.reset(seed=seed)[0]
        shown, actions, rewards, ended = [self._split(observation)], [], [], False
        while not ended and len(rewards) < self._max_steps:
            action, components = self._draw(rng)
            observation, reward, terminated, truncated, _ = self._env.step(action)
            ended = terminated or truncated
            shown.append(self._split(observation))
            actions.append(components)
            rewards.append(float(reward))
        vectors, moments = map(np.array, zip(*shown, strict=True))
        return _Rollout(vectors, moments, np.array(actions), np.array(rewards))

    def quantities(self) -> tuple[list[str], NDArray[np.int64]]:
        """Returns names and irreps, as bits, of the quantities of `centred_sums`."""
        names, irreps = self._names, self._features
        changes = [f"the change of {name}" for name in names]
        action_names = [f"action component {i} ({_IRREPS[irrep]})" for i, irrep in enumerate(self._actions)]
        all_names = names + changes + [f"{name} times the reward" for name in names + action_names]
        all_irreps = [irreps, irreps, irreps, self._actions]
        first, second = np.triu_indices(len(names), 1)
        all_names += [f"{names[i]} times {names[j]}" for i, j in zip(first, second, strict=True)]
        all_irreps.append(irreps[first] ^ irreps[second])
        for action, irrep in zip(action_names, self._actions, strict=True):
            all_names += [f"{action} times {change}" for change in changes]
            all_names += [f"{action} times {change} times {name}" for change, name in zip(changes, names, strict=True)]
            all_names += [f"{action} times {name} times the reward" for name in names]
            all_irreps += [irrep ^ irreps, np.full_like(irreps, irrep), irrep ^ irreps]
        return all_names, np.concatenate(all_irreps)

    def centred_sums(self, rollouts: list[_Rollout], acts: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Returns the sums over each episode of all quantities, `[E, K]`. Rewards, and features of irreps that the
        group does not act on, enter with their mean subtracted: it is the same for transformed episodes, and without
        it products have less noise."""
        features = [np.concatenate([each.vector, each.image], axis=1) for each in rollouts]
        means = np.concatenate([each[:-1] for each in features]).mean(axis=0) * ~acts[self._features]
        reward = np.concatenate([each.reward for each in rollouts]).mean()
        first, second = np.triu_indices(len(means), 1)
        sums = []
        for rollout, each in zip(rollouts, features, strict=True):
            before, change = each[:-1] - means, np.diff(each, axis=0)
            paid = rollout.reward[:, None] - reward
            parts = [before, change, before * paid, rollout.action * paid]
            totals = [part.sum(axis=0) for part in parts] + [(before.T @ before)[first, second]]
            for action in rollout.action.T:
                totals += [action @ change, action @ (change * before), action @ (before * paid)]
            sums.append(np.concatenate(totals))
        return np.array(sums)

    def _draw(self, rng: np.random.Generator) -> tuple[Any, NDArray[np.float64]]:
        """Returns a random action and its components. A continuous one is normal with half the width of its box."""
        space = self._env.action_space
        if not self._choices:
            numbers = rng.standard_normal(space.shape)
            width = np.where(np.isfinite(space.high - space.low), (space.high - space.low) / 2, 1)
            return np.clip(numbers * width, space.low, space.high).astype(space.dtype), numbers.ravel()
        chosen = [int(rng.integers(choices)) for choices in self._choices]
        ones = np.concatenate([np.eye(n)[k] for n, k in zip(self._choices, chosen, strict=True)])
        # choices that the group exchanges begin with the trivial irrep
        starts = [*np.flatnonzero(self._actions == 0), len(ones)]
        for start, end in itertools.pairwise(starts):
            orbit = ones[start:end]
            orbit[:] = _HADAMARD[: len(orbit), : len(orbit)] @ orbit
        return space.start + (chosen[0] if isinstance(space, Discrete) else np.array(chosen)), ones

    def _split(self, observation: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the observation without its image as one vector, and the moments of the image."""
        space, pixels = self._env.observation_space, None
        if self._image is None:
            vector = flatten(space, observation).astype(float)
        elif self._image:
            pixels = observation[self._image]
            rest = {name: part for name, part in observation.items() if name != self._image}
            spaces = Dict({name: space[name] for name in rest})
            vector = flatten(spaces, rest).astype(float) if rest else np.zeros(0)
        else:
            vector, pixels = np.zeros(0), observation
        if pixels is None:
            return vector, np.zeros(0)
        return vector, (np.einsum("mhw,hwc->cm", self._weights, pixels) / self._units).ravel()
