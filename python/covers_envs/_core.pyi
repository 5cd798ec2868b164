"""Native part of the package. It is private, see `covers_envs.vector`."""

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

ACTION_DIM: Final[int]

_Bools: TypeAlias = NDArray[np.bool_]
_Out: TypeAlias = tuple[
    NDArray[np.uint8],
    NDArray[np.float32],
    NDArray[np.uint8],
    NDArray[np.float32],
    tuple[NDArray[np.float32], _Bools, _Bools, _Bools],
]

def task_names() -> list[str]: ...
def task_sets() -> list[tuple[str, list[str]]]: ...

class Core:
    def __init__(
        self,
        tasks: list[str],
        num_envs: int,
        threads: int,
        camera: str,
        layout: str,
        embodiment: str,
        seed: int,
        *,
        action_repeat: int | None = None,
        displacement: float | None = None,
        horizon: int | None = None,
    ) -> None: ...
    def decisions(self) -> int: ...
    def image_channels(self) -> int: ...
    def settings(self) -> str: ...
    def reseed(self, seed: int) -> None: ...
    def set_tasks(self, tasks: list[str]) -> None: ...
    def advance(
        self, actions: NDArray[np.float32], commands: NDArray[np.uint8], out: _Out
    ) -> list[tuple[int, str]]: ...
    def expert_actions(self, actions: NDArray[np.float32]) -> None: ...
    def close(self) -> None: ...
    def require_own_process(self) -> None: ...
