"""Scores runs behind misaligned cameras: misalignment.py COVERS RUNS_FOLDER TABLE.csv.

COVERS is the program, RUNS_FOLDER holds finished runs covers-sac-NETWORK-seedN with their
checkpoints, which were trained with an aligned camera. Each is scored with the camera shifted along
x, or tilted about y, by amounts that nothing corrects, in 40 episodes of each group. The scores go
to TABLE.csv; rows that are there already are not measured again. A table of the mean success of the
groups' own policies is printed.
"""

import csv
import json
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean

# shift along x (mm), tilt about y (degrees)
ERRORS = [(0, 0), (10, 0), (20, 0), (30, 0), (0, -1), (0, -2), (0, -3)]
FIELDS = ["network", "seed", "shift_mm", "tilt_degrees", "group", "element", "seen", "policy",
          "success", "own_policy", "own_success"]


def scores(program, run, shift, tilt):
    """Scores of a run in all variants, from `covers eval --json`."""
    camera = "envs.camera.misalignment"
    command = [program, "eval", run, "--episodes", "40", "--seed", "4", "--threads", "1", "--json",
               "--set", f"{camera}.shift_mm=[{shift},0]", "--set",
               f"{camera}.tilt_degrees=[0,{tilt}]"]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return json.loads(output.splitlines()[-1])


def main(program, runs, table):
    """Measures what the table lacks, and prints the summary."""
    table = Path(table)
    rows = []
    if table.exists():
        with open(table, newline="") as file:
            rows = list(csv.DictReader(file))
    done = {tuple(row[name] for name in FIELDS[:4]) for row in rows}
    for run in sorted(folder for folder in Path(runs).iterdir() if folder.is_dir()):
        network, seed = re.fullmatch(r"covers-sac-(.+)-seed(\d+)", run.name).groups()
        for shift, tilt in ERRORS:
            key = (network, seed, str(shift), str(tilt))
            if key in done:
                continue
            for score in scores(program, run, shift, tilt):
                own = score["own"]
                cells = [score["group"], score["element"], score["seen"], score["policy"],
                         score["success"], own["policy"], own["success"]]
                rows.append(dict(zip(FIELDS, [*key, *map(str, cells)])))
            with open(table, "w", newline="") as file:
                writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
    means = defaultdict(list)
    for row in rows:
        for group in (row["group"], "average"):
            error = (int(row["shift_mm"]), int(row["tilt_degrees"]))
            means[row["network"], group, error].append(float(row["own_success"]))
    names = [f"{-tilt}°" if tilt else f"{shift} mm" for shift, tilt in ERRORS]
    print(f"| network | group | {' | '.join(names)} |")
    print("|---" * (len(ERRORS) + 2) + "|")
    # the average last
    pairs = dict.fromkeys(key[:2] for key in means)
    for network, group in sorted(pairs, key=lambda pair: (pair[0], pair[1] == "average")):
        cells = [f"{fmean(means[network, group, error]):.3f}" for error in ERRORS]
        print(f"| {network} | {group} | {' | '.join(cells)} |")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
