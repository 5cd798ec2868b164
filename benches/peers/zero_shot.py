"""Tells how well variants that were never trained on are solved: zero_shot.py RUNS_FOLDER.

RUNS_FOLDER holds finished runs of the plan docs/results/plans/zero-shot.json
(docs/results/data/efficiency-zero-shot.tar.gz), in folders METHOD-NAME-seedN. For each network and
group the script prints the mean success of the seen variant and of the three others after the
stream, by the policies that the learner recognised and by the groups' own, and the share of unseen
variants whose own policy was recognised. Below, the average over groups of the unseen variants is
compared between networks, by Welch's t-test over seeds.
"""

import csv
import re
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean

from scipy import stats

NETWORKS = {
    "d2": "equivariant",
    "ordinary": "ordinary",
    "mirrored": "ordinary, mirrored replay",
}


def scores_of(folder):
    """Rows of a run's evaluation after the stream."""
    with open(folder / "evaluation.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    last = max(int(row["rollouts"]) for row in rows)
    return [row for row in rows if int(row["rollouts"]) == last]


def own(row):
    """Success of the policy that served the group in most of its rollouts."""
    return float(row["own_success"])


def line(name, group, rows):
    """A row of the first table."""
    seen = [row for row in rows if row["seen"] == "true"]
    unseen = [row for row in rows if row["seen"] == "false"]
    right = fmean(row["own_policy"] == row["policy"] for row in unseen)
    cells = [name, group]
    for part in (seen, unseen):
        cells.append(f"{fmean(float(row['success']) for row in part):.3f}")
        cells.append(f"{fmean(map(own, part)):.3f}")
    return "| " + " | ".join([*cells, f"{right:.2f}"]) + " |"


def interval(values):
    """A mean with its 95 % interval by Student's t."""
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1)
    return f"{fmean(values):.3f} ± {half:.3f}"


def main(runs):
    """Prints both tables."""
    scores = defaultdict(dict)
    for folder in sorted(Path(runs).iterdir()):
        name, seed = re.fullmatch(r".+-(\w+)-seed(\d+)", folder.name).groups()
        scores[name][int(seed)] = scores_of(folder)
    (seeds,) = {tuple(sorted(of_seeds)) for of_seeds in scores.values()}
    print(f"seeds {seeds[0]} to {seeds[-1]}: {len(seeds)} runs of each network\n")
    print("| network | group | seen | seen, own policy | unseen | unseen, own policy "
          "| own policy recognised |")
    print("|---|---|---|---|---|---|---|")
    for key, name in NETWORKS.items():
        rows = [row for run in scores[key].values() for row in run]
        for group in dict.fromkeys(row["group"] for row in rows):
            print(line(name, group, [row for row in rows if row["group"] == group]))
        print(line(name, "average", rows))
    print("\n| unseen variants, own policies | average (95 % by Student's t) | lowest seed "
          "| difference from the equivariant | p (Welch's t) |")
    print("|---|---|---|---|---|")
    averages = {key: [fmean(own(row) for row in scores[key][seed] if row["seen"] == "false")
                      for seed in seeds] for key in NETWORKS}
    for key, name in NETWORKS.items():
        values, best = averages[key], averages["d2"]
        cells = [name, interval(values), f"{min(values):.3f}", "-", "-"]
        if key != "d2":
            cells[3] = f"{fmean(values) - fmean(best):+.3f}"
            cells[4] = f"{stats.ttest_ind(values, best, equal_var=False).pvalue:.1e}"
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
