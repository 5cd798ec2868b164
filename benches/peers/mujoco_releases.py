"""Prints what differs between releases of MuJoCo, as a Markdown table: mujoco_releases.py PROGRAM FOLDER ...

PROGRAM is `covers` of MuJoCo 2.2.2. Each FOLDER is of another release, as tests/mujoco3.sh makes it: the wheel's folder
`mujoco`, and `build` with the program and the timings of environments. `make mujoco3` calls this.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

RECORDINGS = "tests/recordings"
EPISODES = 100
TIMED = {
    "physics, sawyer, drawer-close (control steps/s, one thread)": "state sawyer drawer-close 1",
    "the same with images": "image sawyer drawer-close 1",
    "physics, hand, push": "state hand push 1",
}


class Release:
    """Programs that are linked to one release of MuJoCo."""

    def __init__(self, program: Path, library: Path | None) -> None:
        self._programs = program.parent
        path = {} if library is None else {"LD_LIBRARY_PATH": str(library)}
        self._env = os.environ | path | {"LP_NUM_THREADS": "0"}

    def run(self, *arguments: str) -> str:
        """Returns the standard output of `covers`. `check` and `doctor` fail where they find differences."""
        command = [self._programs / "covers", *arguments]
        strict = arguments[0] not in ("check", "doctor")
        return subprocess.run(command, env=self._env, stdout=subprocess.PIPE, text=True, check=strict).stdout

    def read(self, *arguments: str):
        """Returns the JSON in the last line of the output of `covers`."""
        return json.loads(self.run(*arguments, "--json").splitlines()[-1])

    def rate(self, line: str) -> float:
        """Returns the control steps a second that the timings of environments answer to a line."""
        program = self._programs / "examples/env_times"
        answer = subprocess.run([program], env=self._env, input=line + "\n", stdout=subprocess.PIPE, text=True, check=True)
        return float(answer.stdout.split()[-1])

    def pictures(self) -> np.ndarray:
        """Returns the contact sheet of the first four groups, as integers."""
        with tempfile.TemporaryDirectory() as folder:
            self.run("train", "--preset", "covers", "--budget", "smoke", "--seed", "1000", "--folder", folder)
            return np.asarray(Image.open(Path(folder) / "contact_sheet.png").convert("RGB"), np.int32)


def figures(release: Release, sheet: np.ndarray) -> dict[str, str]:
    version = next(part["found"] for part in release.read("doctor") if part["part"] == "simulator")
    recordings = release.read("check", "parity", RECORDINGS)
    experts = release.read("check", "experts", "--tasks", "all", "--seeds", "2")
    by_group: dict[str, list[float]] = {}
    for variant in release.read("eval", "assets/pretrained", "--episodes", str(EPISODES)):
        by_group.setdefault(variant["group"], []).append(variant["success"])
    difference = np.abs(release.pictures() - sheet)

    def largest(name: str) -> str:
        return f"{max(each[name] for each in recordings):.1e}"

    solved = sum(each["successes"] for each in experts)
    played = sum(each["episodes"] for each in experts)
    table = {
        "release": version.removeprefix("MuJoCo "),
        "recordings of Meta-World on 2.2.2: largest difference of a reward": largest("reward_deviation"),
        "largest difference after a single step": largest("physics_max"),
        "median over recordings of the same": f"{np.median([each['physics_median'] for each in recordings]):.1e}",
        "mismatches of success": str(sum(each["success_mismatches"] for each in recordings)),
        "scripted experts, all variants of both layouts, two embodiments": f"{solved} of {played}",
        f"policies of assets/pretrained ({', '.join(by_group)})": ", ".join(f"{np.mean(each):.2f}" for each in by_group.values()),
        "pixels of the contact sheet that differ by more than 2 of 255": f"{(difference.max(-1) > 2).mean():.2%}",
        "largest difference of a pixel": str(difference.max()),
    }
    return table | {name: f"{release.rate(line):,.0f}" for name, line in TIMED.items()}


def main() -> None:
    reference = Release(Path(sys.argv[1]), None)
    others = [Release(Path(name) / "build/covers", Path(name) / "mujoco") for name in sys.argv[2:]]
    sheet = reference.pictures()
    columns = [figures(release, sheet) for release in [reference, *others]]
    for row, name in enumerate(columns[0]):
        print(f"| {' | '.join([name, *(column[name] for column in columns)])} |")
        if row == 0:
            print("|---" * (len(columns) + 1) + "|")


if __name__ == "__main__":
    main()
