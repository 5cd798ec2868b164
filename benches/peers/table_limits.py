"""Figures behind the limits of the table of methods: table_limits.py RUNS_FOLDER.

RUNS_FOLDER holds the runs of docs/results/data/table.tar.gz. For each method with PPO the script
prints the average success after the stream; an estimate of what it would be if the variants that
another policy played had the success of the others of their group and run (unchanged where there
are none); success in the last eight training rollouts of each group; and, for each third of the
stream, the mean logarithm of the actions' standard deviation and the passes of an update.
"""

import csv
import sys
from collections import Counter, defaultdict
from pathlib import Path
from statistics import fmean

METHODS = ["covers", "covers-gt", "covers-cnn", "covers-cnn-slim", "equi", "cnn"]
LATEST = 8  # training rollouts of a group


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def usual_policies(rollouts):
    """The policy that served each group in most of its rollouts."""
    served = defaultdict(Counter)
    for row in rollouts:
        if row["straddles"] != "true":
            served[row["group"]][row["policy"]] += 1
    return {group: policies.most_common(1)[0][0] for group, policies in served.items()}


def successes(rollouts, scores):
    """Averages over groups: as evaluated, as estimated, and in the latest training rollouts."""
    last = max(int(row["rollouts"]) for row in scores)
    evaluated, estimated, trained = [], [], []
    for group, policy in usual_policies(rollouts).items():
        rows = [row for row in scores if row["group"] == group and int(row["rollouts"]) == last]
        served = [row for row in rows if row["policy"] == policy] or rows
        evaluated.append(fmean(float(row["success"]) for row in rows))
        estimated.append(fmean(float(row["success"]) for row in served))
        latest = [row for row in rollouts if row["group"] == group][-LATEST:]
        trained.append(fmean(float(row["success"]) for row in latest))
    return [fmean(evaluated), fmean(estimated), fmean(trained)]


def thirds(rollouts, value):
    """Means of a value over the three thirds of a run's rollouts."""
    ends = [len(rollouts) * third // 3 for third in range(4)]
    return [fmean(map(value, rollouts[begin:end])) for begin, end in zip(ends, ends[1:])]


def log_deviation(row):
    return fmean(float(row[name]) for name in row if name.startswith("log_std_"))


def main(runs):
    """Prints the table."""
    print("| method | success | estimate | in training | log deviation | passes |")
    print("|---|---|---|---|---|---|")
    for method in METHODS:
        folders = sorted(Path(runs).glob(f"{method}-seed*"))
        if not folders:
            sys.exit(f"{runs} has no runs of {method}")
        columns = defaultdict(list)
        for folder in folders:
            rollouts = rows_of(folder / "metrics.csv")
            columns["success"].append(successes(rollouts, rows_of(folder / "evaluation.csv")))
            columns["deviation"].append(thirds(rollouts, log_deviation))
            columns["passes"].append(thirds(rollouts, lambda row: float(row["epochs"])))
        means = {name: list(map(fmean, zip(*rows))) for name, rows in columns.items()}
        cells = [f"{value:.3f}" for value in means["success"]]
        cells.append(", ".join(f"{value:.2f}" for value in means["deviation"]))
        cells.append(", ".join(f"{value:.1f}" for value in means["passes"]))
        print("| " + " | ".join([method, *cells]) + " |")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
