"""Training of COVERS on streams of tasks, and the policies of a run as functions of NumPy arrays."""

import json
import os
import warnings
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from covers_envs import _core
from covers_envs.policy import base_env, require_equal

Folder: TypeAlias = str | PathLike[str]
Progress: TypeAlias = Callable[[dict[str, Any]], object]


def train(
    folder: Folder,
    method: str = "covers-sac",
    budget: str = "short",
    *,
    seed: int = 0,
    threads: int | None = None,
    settings: dict[str, Any] | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Trains a method on its stream of unlabelled tasks, and returns the run's summary.

        summary = covers_envs.train("runs/first", progress=print)
        {group["group"]: group["success"] for group in summary["groups"]}

    The run is that of `covers train --preset METHOD --budget BUDGET --seed SEED`, number for number,
    and the program's commands take its folder, too. An interrupt leaves a checkpoint, from which
    `resume` continues.

    Args:
        folder: New folder for the files of the run.
        method: Name of a preset, such as `covers`, `covers-sac` or `clear`.
        budget: Length of the stream: `smoke` (seconds), `short`, `full`, `ten` and others.
        seed: Seed of all random numbers of the run.
        threads: Number of worker threads; that of the available cores if None. Numbers do not depend
            on it.
        settings: Changed settings by path, such as `{"off_policy.sac.learning_rate": 1e-3}`.
        progress: Function that is called after every event of the run, with a dictionary. It holds
            `event` (`rollout` or `evaluation`), `decisions` and `total_decisions`; for a rollout
            `group` (the true one, which the learner does not see), `policy`, `policy_created`,
            `success`, `return` and `seconds`; for an evaluation `success`, of each group. `success`
            and `return` of a rollout in which no episode ended are None.

    Raises:
        FileExistsError: `folder` holds a run.
        ValueError: A name or a setting is unknown or out of range.
    """
    path = Path(folder)
    if (path / "experiment.json").exists():
        raise FileExistsError(f"{path} holds a run: continue it with `covers_envs.resume`, or name another folder")
    changed = [f"{name}={json.dumps(value)}" for name, value in (settings or {}).items()]
    run = _core.TrainingRun.start(path, method, budget, seed, _threads(threads), changed)
    return _finish(run, progress)


def resume(folder: Folder, *, threads: int | None = None, progress: Progress | None = None) -> dict[str, Any]:
    """Continues the run in `folder` from its last checkpoint, and returns its summary; see `train`."""
    return _finish(_core.TrainingRun.resume(Path(folder), _threads(threads)), progress)


def run_settings(folder: Folder) -> dict[str, Any]:
    """Returns settings of environments like those in which the policies of a run were trained.

        env = covers_envs.make_vec("drawer-close", 32, **covers_envs.run_settings("runs/first"))
    """
    return json.loads(_core.run_environment_settings(Path(folder)))


class RunPolicy:
    """Policy of a run as a function of NumPy arrays: `actions = policy(observation)`.

    Raises ValueError for environments whose images, layout or effect of actions differ from those of
    the policy's training, even if all shapes agree.

    Args:
        folder: Folder of a run, or a folder that `covers pack` created.
        policy: Name of the group that the policy serves, or the policy's index. Where no policy trained on
            the group, and in packed folders, it is the policy that images of the group fit best, with a
            warning if they fit none well.
        env: Environments that were made with `run_settings(folder)`; they may be wrapped.
    """

    def __init__(self, folder: Folder, policy: str | int, env: Any) -> None:
        self._policies = _core.Policies(Path(folder))
        require_equal(base_env(env).settings, json.loads(self._policies.settings()), "run_settings")
        index, count = policy, self._policies.count()
        if isinstance(policy, str):
            index, fits = self._policies.policy_of_group(policy)
            if not fits:
                warnings.warn(f"images of {policy!r} fit no policy of {folder} well; the nearest is {index}", stacklevel=2)
        if type(index) is not int or not 0 <= index < count:
            raise ValueError(f"policy {policy!r} is not in {folder}: indices are 0 to {count - 1}")
        #: Index of the policy in the run.
        self.index: int = index

    def __call__(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Returns the policy's mean actions, float32 `[N, 4]` in [-1, 1]; `[4]` for one environment."""
        images, vectors = observation["image"], observation["vector"]
        if images.dtype != np.uint8:
            raise ValueError(f"images are {images.dtype}, expected uint8 as the environments make them")
        one = vectors.ndim == 1
        if one:
            images, vectors = images[None], vectors[None]
        images, vectors = np.ascontiguousarray(images), np.ascontiguousarray(vectors, np.float32)
        actions = np.empty((len(vectors), _core.ACTION_DIM), np.float32)
        self._policies.actions(self.index, images, vectors, actions)
        actions = actions.clip(-1, 1)
        return actions[0] if one else actions


def _threads(threads: int | None) -> int:
    return len(os.sched_getaffinity(0)) if threads is None else threads


def _finish(run: Any, progress: Progress | None) -> dict[str, Any]:
    try:
        while (figures := run.advance()) is not None:
            if progress is not None:
                progress(json.loads(figures))
        return json.loads(run.summary())
    except BaseException:
        run.save()
        raise
    finally:
        # a traceback that an interpreter keeps would hold the folder's lock
        run.close()
