"""Exported policies, as `covers export` writes them, for use in these environments."""

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covers_envs.single import CoversEnv
from covers_envs.vector import CoversVectorEnv

#: Version of `policy.json` that this module reads.
_FORMAT = "covers-policy 1"

Folder = str | PathLike[str]


def policy_settings(folder: Folder) -> dict[str, Any]:
    """Returns settings of environments like those in which an exported policy was trained.

        env = covers_envs.make_vec("drawer-close", 32, **covers_envs.policy_settings("drawer"))

    Args:
        folder: Folder that `covers export --out` created.
    """
    about = _description(folder)
    action, environment = about["outputs"]["action"], about["environment"]
    # policies may see no images
    images = [about["inputs"]["image"]] if "image" in about["inputs"] else []
    return environment | {"camera": image["camera"] for image in images} | {
        "action_repeat": action["control_steps_per_decision"],
        "displacement": action["displacement"],
    }


class OnnxPolicy:
    """Exported policy that onnxruntime runs: `actions = policy(observation)`.

    Raises ValueError for environments whose images, layout or effect of actions differ from those of
    the policy's training, even if all shapes agree.

    Args:
        folder: Folder that `covers export --out` created.
        env: Environments that were made with `policy_settings(folder)`; they may be wrapped.
    """

    def __init__(self, folder: Folder, env: Any) -> None:
        import onnxruntime

        require_equal(base_env(env).settings, policy_settings(folder), "policy_settings")
        components = _description(folder)["inputs"].get("vector", {"components": []})["components"]
        self._offset = np.array([each["offset"] for each in components], np.float32)
        self._factor = np.array([each["factor"] for each in components], np.float32)
        path = Path(folder) / "policy.onnx"
        self._session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        self._inputs = [each.name for each in self._session.get_inputs()]

    def __call__(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Returns the policy's mean actions, float32 `[N, 4]` in [-1, 1]; `[4]` for one environment."""
        one = observation["vector"].ndim == 1
        rows = {name: array[None] if one else array for name, array in observation.items()}
        if "vector" in self._inputs:
            rows["vector"] = (rows["vector"] - self._offset) * self._factor
        (actions,) = self._session.run(["action"], {name: rows[name] for name in self._inputs})
        actions = actions.clip(-1, 1)
        return actions[0] if one else actions


def _description(folder: Folder) -> dict[str, Any]:
    path = Path(folder) / "policy.json"
    about = json.loads(path.read_text("utf-8"))
    if about.get("format") != _FORMAT or "environment" not in about:
        raise ValueError(
            f"{path} is of the format {about.get('format')!r}, expected {_FORMAT!r} with `environment`: "
            "export the policy again with the `covers` of this version"
        )
    return about


def base_env(env: Any) -> CoversEnv | CoversVectorEnv:
    """Returns the environments of this package inside of wrappers."""
    base = getattr(env, "unwrapped", env)
    if not isinstance(base, (CoversEnv, CoversVectorEnv)):
        raise TypeError(f"`env` is a {type(base).__name__}, expected a CoversEnv or a CoversVectorEnv")
    return base


def require_equal(settings: dict[str, Any], expected: dict[str, Any], source: str) -> None:
    """Raises ValueError unless environments of these settings give a policy the images and the effect of actions of its
    training; `source` is the function that returned `expected`."""
    have, want = _compared(settings), _compared(expected)
    names = [name for name in want if have.get(name) != want[name]]
    if names:
        wrong = ", ".join(f"{name} is {have.get(name)!r}, expected {want[name]!r}" for name in names)
        raise ValueError(
            f"the policy was trained in other environments: {wrong}; "
            f"make environments with `**covers_envs.{source}(...)`"
        )


def _compared(settings: dict[str, Any]) -> dict[str, Any]:
    """Returns the settings that must agree: those of images and of the effect of actions. The embodiment may differ."""
    camera = {f"camera.{name}": value for name, value in settings.get("camera", {}).items()}
    return camera | {name: settings[name] for name in ("layout", "action_repeat", "displacement")}
