"""Tells how well variants that were never trained on are solved: zero_shot.py RUNS_FOLDER.

RUNS_FOLDER holds finished runs of the plan docs/results/plans/zero-shot.json, and, if you like, of
wide-zero-shot.json, in folders covers-sac-NETWORK-seedN
(docs/results/data/efficiency-zero-shot.tar.gz). For each network and group the script prints the
mean success of the seen variant and of the three others after the stream, by the policies that the
learner recognised and by the groups' own, and the share of unseen variants whose own policy was
recognised. Below, the average over groups of the unseen variants, played by their own policies, is
compared between networks, by Welch's t-test and an exact permutation test over seeds.
"""

import re
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean

from final_scores import own, scores_of
from seed_tests import interval, p_values, text_of

NETWORKS = {
    "d2": "equivariant",
    "ordinary": "ordinary",
    "mirrored": "ordinary, mirrored replay",
    "wide-ordinary": "wide ordinary",
    "wide-mirrored": "wide ordinary, mirrored replay",
}


def runs_of(runs):
    """Scores by network and seed."""
    scores = defaultdict(dict)
    for folder in sorted(folder for folder in Path(runs).iterdir() if folder.is_dir()):
        name = re.fullmatch(r"covers-sac-(.+)-seed(\d+)", folder.name)
        if not name or name[1] not in NETWORKS:
            sys.exit(f"{folder} is not a run of the plans")
        scores[name[1]][int(name[2])] = scores_of(folder)
    if "d2" not in scores:
        sys.exit(f"{runs} has no runs of the network d2")
    return {key: scores[key] for key in NETWORKS if key in scores}


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


def main(runs):
    """Prints both tables."""
    scores = runs_of(runs)
    print("| network | group | seen | seen, own policy | unseen | unseen, own policy "
          "| own policy recognised |")
    print("|---|---|---|---|---|---|---|")
    for key, of_seeds in scores.items():
        rows = [row for run in of_seeds.values() for row in run]
        for group in dict.fromkeys(row["group"] for row in rows):
            print(line(NETWORKS[key], group, [row for row in rows if row["group"] == group]))
        print(line(NETWORKS[key], "average", rows))
    averages = {key: [fmean(own(row) for row in run if row["seen"] == "false")
                      for run in of_seeds.values()] for key, of_seeds in scores.items()}
    best = averages["d2"]
    print("\n| unseen variants, own policies | seeds | average (95 % by Student's t) | lowest seed "
          "| difference from the equivariant | p (Welch's t) | p (permutations of seeds) |")
    print("|---|---|---|---|---|---|---|")
    for key, values in averages.items():
        cells = [NETWORKS[key], str(len(values)), interval(values), f"{min(values):.3f}"]
        if key == "d2":
            cells += ["-"] * 3
        else:
            cells += [f"{fmean(values) - fmean(best):+.3f}", *map(text_of, p_values(values, best))]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
