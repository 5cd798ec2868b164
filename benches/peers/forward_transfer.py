"""Computes forward transfer by Continual World's measure: forward_transfer.py STREAMS ALONE...

STREAMS is a quoted pattern of folders, 'runs/sac-stream/*' say, of streams with a policy per group,
and each ALONE one of runs of one of their groups alone, by the same learner. In a group, A is the
area under a stream's success in training, divided by the decisions, and B the mean of the same area
over the runs alone, both over as many of the first decisions in the group as all runs have. Forward
transfer is (A - B) / (1 - B) (Wolczyk et al., "Continual World", NeurIPS 2021). Positive values
mean that earlier groups helped. Decisions of undecided rollouts count with the group and success of
the next row. The last row takes the mean over the second half of each stream's groups first.
"""

import csv
import sys
from collections import defaultdict
from glob import glob
from pathlib import Path
from statistics import fmean

from seed_tests import interval


def curves_of(folder):
    """Decisions and success of each training iteration of a run, by group in the order of visits."""
    with open(folder / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    curves, before = defaultdict(list), 0
    for row in rows:
        decisions = int(row["decisions"])
        curves[row["group"]].append((decisions - before, float(row["success"])))
        before = decisions
    return curves


def decisions_of(curve):
    return sum(decisions for decisions, _ in curve)


def mean_success(curve, limit):
    """Area under a curve over its first `limit` decisions, divided by these."""
    area, left = 0.0, limit
    for decisions, success in curve:
        decisions = min(decisions, left)
        area += decisions * success
        left -= decisions
    return area / limit


def runs_of(pattern):
    runs = [curves_of(Path(folder)) for folder in sorted(glob(pattern))]
    return runs or sys.exit(f"{pattern} matches no folder")


def main(streams, alone):
    """Prints forward transfer by group and by the order in which groups were met."""
    runs = runs_of(streams)
    by_place, by_group, by_run = defaultdict(list), defaultdict(list), defaultdict(list)
    for curves_alone in map(runs_of, alone):
        groups = {group for curves in curves_alone for group in curves}
        if len(groups) != 1:
            sys.exit(f"expected runs of one group, found {sorted(groups)}")
        group = groups.pop()
        curves_alone = [curves[group] for curves in curves_alone]
        limit = min(map(decisions_of, [*curves_alone, *(curves[group] for curves in runs)]))
        expected = fmean(mean_success(curve, limit) for curve in curves_alone)
        for run, curves in enumerate(runs):
            transfer = (mean_success(curves[group], limit) - expected) / (1 - expected)
            place = list(curves).index(group) + 1
            by_place[place].append(transfer)
            if place > 1:
                by_group[f"{group} (first {limit} decisions)"].append(transfer)
            if place > len(curves) / 2:
                by_run[run].append(transfer)
    print("| | streams | forward transfer (95 % by Student's t) |\n|---|---|---|")
    for place, values in sorted(by_place.items()):
        print(f"| group {place} of the stream | {len(values)} | {interval(values)} |")
    for group, values in by_group.items():
        print(f"| {group}, not as first group | {len(values)} | {interval(values)} |")
    means = [fmean(values) for values in by_run.values()]
    print(f"| second half of the groups | {len(means)} | {interval(means)} |")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
