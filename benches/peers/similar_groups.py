"""Tells how far groups that look alike are from each other: similar_groups.py RUNS_FOLDER.

RUNS_FOLDER holds finished runs of ten groups (docs/results/data/efficiency-ten.tar.gz). For each
pair of groups with one object, and for all other pairs together, the script prints W1 distances of
first images (of first vectors where all compared images are equal) over the rollouts of all runs:
between a rollout of one group and the policy of the
other, and between rollouts of the two groups and their own policies. The policy of a group is the
one that was created for it. The p-value is the largest of the tests of whole episodes that a
rollout of one group got against the policy of the other.
"""

import csv
import statistics
import sys
from pathlib import Path

ALIKE = [("window-open", "window-close"), ("drawer-open", "drawer-close"),
         ("button-press", "button-press-topdown")]


def comparisons(folder):
    """Group of a rollout, group of a policy, distance and p-value, for all tests of a run."""
    with open(folder / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    group_of = {}
    for row in rows:
        if row["straddles"] == "true":
            continue
        # a rollout that a policy is created on is compared with the policies before it
        before = dict(group_of)
        group_of.setdefault(int(row["policy"]), row["group"])
        distances, p_values = [row[name].split(";") for name in ["distances", "tail_p_values"]]
        for policy, (distance, p_value) in enumerate(zip(distances, p_values)):
            if distance and policy in before:
                yield row["group"], before[policy], float(distance), float(p_value)


def line(name, between, own):
    """A row of the table."""
    apart = [distance for _, _, distance, _ in between]
    same = [distance for _, _, distance, _ in own]
    cells = [name, str(len(between)), f"{min(apart):.3f}", f"{statistics.median(apart):.3f}",
             f"{statistics.median(same):.3f}", f"{max(same):.3f}",
             f"{max(p_value for *_, p_value in between):.0e}"]
    return "| " + " | ".join(cells) + " |"


def main(runs):
    """Prints the table."""
    folders = sorted(folder for folder in Path(runs).iterdir() if folder.is_dir())
    tests = [test for folder in folders for test in comparisons(folder)]
    between = [test for test in tests if test[0] != test[1]]
    own = [test for test in tests if test[0] == test[1]]
    print("| groups | tests | between them: smallest | median | own: median | largest "
          "| largest p-value |")
    print("|---|---|---|---|---|---|---|")
    for pair in ALIKE:
        print(line(" and ".join(f"`{group}`" for group in pair),
                   [test for test in between if {test[0], test[1]} == set(pair)],
                   [test for test in own if test[0] in pair]))
    alike = [set(pair) for pair in ALIKE]
    print(line("all other pairs", [test for test in between if {test[0], test[1]} not in alike],
               own))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
