"""The check of symmetries finds faults in environments of Gymnasium and of this package."""

import itertools

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TransformAction, TransformObservation, TransformReward

import covers_envs

PENDULUM = {"vector": ["1", "x", "x"], "action": ["x"], "group": "D1x"}
CART_POLE = {"vector": ["x"] * 4, "action": ["1", "x"], "group": "D1x"}

#: Faults along one axis, each with what names it.
FAULTS = {
    "sign": "vector component {axis} ",
    "swapped components": "vector component",
    "wrong centre": "vector component {axis} ",
    "joint range": "vector component {axis} ",
    "inertia": "change of vector component {axis} ",
    "tilted camera": "of the image",
    "one-sided reward": "the reward",
    "clock": "change of vector component {axis} ",
    "image rows": "of the image",
    "action scale": "change of vector component {axis} ",
}


class Points(gymnasium.Env):
    """Point that is pushed towards a goal, which the image shows, with a fault along an axis or none."""

    def __init__(self, fault, axis, inertia, shape):
        self.fault, self.axis, self.inertia = fault, axis, inertia
        image = gymnasium.spaces.Box(0, 255, (*shape, 2), np.uint8)
        self.observation_space = gymnasium.spaces.Dict(image=image, vector=gymnasium.spaces.Box(-9, 9, (4,)))
        self.action_space = gymnasium.spaces.Box(-2, 2, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        (self.point, self.goal), self.velocity = self.np_random.uniform(-0.8, 0.8, (2, 2)), np.zeros(2)
        self.age = 0
        return self.observe(), {}

    def observe(self):
        height, width, _ = self.observation_space["image"].shape
        image, point = np.full((height, width, 2), 20, np.uint8), self.point.copy()
        for channel, place in enumerate((self.point, self.goal)):
            place = place.copy()
            if self.fault == "tilted camera":
                place[self.axis] = 0.9 * place[self.axis] + 0.1
            column, row = ((place * [1, -1] + 1) / 2 * [width, height]).astype(int)
            image[min(row, height - 1), min(column, width - 1), channel] = 220
        if self.fault == "image rows":
            image = np.roll(image, 1, axis=0)
        if self.fault == "wrong centre":
            point[self.axis] += 0.15
        if self.fault == "swapped components":
            point = point[::-1]
        return {"image": image, "vector": np.concatenate([point, self.velocity]).astype(np.float32)}

    def step(self, action):
        push, high, axis = 0.2 * np.clip(action, -1, 1), np.ones(2), self.axis
        self.age += 1
        if self.fault == "inertia" and self.point[axis] > 0:
            push[axis] *= 0.5
        if self.fault == "action scale" and push[axis] > 0:
            push[axis] *= 0.7
        if self.fault == "clock":
            push[axis] += 0.003 * self.age
        if self.fault == "joint range":
            high[axis] = 0.6
        self.velocity = self.inertia * self.velocity + push
        self.point = np.clip(self.point + self.velocity, -1, high)
        reward = 1 - np.abs(self.point - self.goal).sum() / 4
        if self.fault == "one-sided reward" and self.point[axis] > 0:
            reward += 0.2
        return self.observe(), reward, False, False, {}


def test_faults_of_ten_kinds_are_named_and_none_where_there_is_none():
    """Forty environments with a fault and forty without: with and without inertia, with square images and others."""
    irreps = {"vector": ["x", "y", "x", "y"], "action": ["x", "y"], "image": "image"}
    missed = []
    for kind, (index, (fault, named)) in itertools.product(range(4), enumerate(FAULTS.items())):
        axis, shape, inertia = kind % 2, ((12, 12), (8, 14))[kind // 2], (0.0, 0.7)[kind // 2]
        settings = {"episodes": 500, "max_steps": 15, "seed": 10 * kind + index}
        faulty = irreps
        if fault == "sign":
            faulty = irreps | {"vector": [irrep if i != axis else "1" for i, irrep in enumerate(irreps["vector"])]}
        found = covers_envs.check_symmetry(Points(fault, axis, inertia, shape), **faulty, **settings).violations
        # position and velocity of an axis
        names = [named.format(axis=i) for i in (axis, axis + 2)]
        hits = [any(name in each.quantity for name in names) for each in found]
        # what is wrong with images or rewards alone leaves other quantities alone
        alone = fault in ("tilted camera", "image rows", "one-sided reward")
        if not (hits and (all(hits) if alone else any(hits))):
            missed.append((fault, kind, [each.quantity for each in found]))
        right = covers_envs.check_symmetry(Points(None, axis, inertia, shape), **irreps, **settings)
        assert right.ok, right
    assert len(missed) <= 2, missed


class Choices(gymnasium.Env):
    """Point that stays where it begins, whose choices and rewards have nothing to do with each other."""

    observation_space, action_space = gymnasium.spaces.Box(-1, 1, (2,)), gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point = self.np_random.uniform(-1, 1, 2)
        return self.point.astype(np.float32), {}

    def step(self, action):
        return self.point.astype(np.float32), -abs(self.point[1]), False, False, {}


def test_actions_do_not_depend_on_the_first_state():
    irreps = {"vector": ["x", "y"], "action": ["1", "x"]}
    for seed in range(5):
        report = covers_envs.check_symmetry(Choices(), **irreps, episodes=500, max_steps=5, seed=seed)
        assert report.ok, report


def pendulum():
    return gymnasium.make("Pendulum-v1")


def test_environments_without_faults_are_not_reported():
    for env, irreps in ((pendulum(), PENDULUM), (gymnasium.make("CartPole-v1"), CART_POLE)):
        report = covers_envs.check_symmetry(env, **irreps)
        assert report.ok and set(report.noise.values()) == {0.0}, report
    env = covers_envs.make("button-press", embodiment="hand", image_size=16)
    report = covers_envs.check_symmetry(env)
    assert report.ok and report.noise == {"vector": 0.0, "image": 0.0, "reward": 0.0}, report


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (lambda env: TransformObservation(env, lambda o: o + np.float32([0, 0.2, 0]), None), "vector component 1 "),
        (
            lambda env: TransformAction(env, lambda a: np.where(a > 0, a, a / 2).astype(np.float32), None),
            "vector component",
        ),
        (lambda env: TransformReward(env, lambda r: 0.5 * r), None),
    ],
    ids=["centre", "action scale", "none"],
)
def test_faults_are_named(fault, named):
    report = covers_envs.check_symmetry(fault(pendulum()), **PENDULUM)
    if named is None:
        assert report.ok, report
    else:
        assert any(named in each.quantity for each in report.violations), report
        assert "standard errors away" in str(report)


def test_wrong_irreps_and_one_sided_tasks_are_reported():
    wrong = covers_envs.check_symmetry(pendulum(), **PENDULUM | {"vector": ["x", "x", "x"]})
    assert "vector component 0" in wrong.violations[0].quantity, wrong
    one_sided = covers_envs.make("goal-reach-flip-x", embodiment="hand", image_size=16)
    report = covers_envs.check_symmetry(one_sided, episodes=60)
    assert any("vector component 4" in each.quantity for each in report.violations), report


def test_noise_between_identical_rollouts_is_reported():
    rng = np.random.default_rng(0)
    noisy = TransformReward(pendulum(), lambda reward: reward + rng.normal())
    assert covers_envs.check_symmetry(noisy, **PENDULUM).noise["reward"] > 0.1


def test_what_cannot_be_checked_is_refused():
    with pytest.raises(ValueError, match="`action` is None"):
        covers_envs.check_symmetry(pendulum())
    with pytest.raises(ValueError, match="irrep 'z', expected 1, x, y or xy"):
        covers_envs.check_symmetry(pendulum(), **PENDULUM | {"action": ["z"]})
    with pytest.raises(ValueError, match="`episodes` is 2, expected at least 48"):
        covers_envs.check_symmetry(pendulum(), episodes=2, max_steps=10, **PENDULUM)
    with pytest.raises(ValueError, match="expected a Box of uint8"):
        covers_envs.check_symmetry(pendulum(), image="", **PENDULUM)
