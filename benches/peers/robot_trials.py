"""Tells how well policies of several streams act on a robot: robot_trials.py TRIALS.csv ...

Each file is the `trials.csv` that `covers deploy --out` wrote for the policies of one stream, under
the name of the stream. The script prints the success of each stream in each group, the means over
streams with intervals of 95 % by Student's t, and the trials with the usual policy: the one that
the learner chose for the group in most of the stream's trials, another one for each group.
"""

import csv
import sys
from collections import Counter
from pathlib import Path
from statistics import fmean

from seed_tests import interval


def usual_policies(rows):
    """Number of trials with the policy that was chosen for their group in most trials."""
    chosen = {}
    for row in rows:
        chosen.setdefault(row["group"], Counter())[row["policy"]] += 1
    usual = {group: counts.most_common(1)[0] for group, counts in chosen.items()}
    if len({policy for policy, _ in usual.values()}) < len(usual):
        sys.exit(f"two groups share a policy: {usual}")
    return sum(count for _, count in usual.values())


def main(paths):
    """Prints the table of all streams."""
    streams = {}
    for path in map(Path, paths):
        if path.stem in streams:
            sys.exit(f"two files are named {path.stem}: name each after its stream")
        with open(path, newline="") as file:
            streams[path.stem] = list(csv.DictReader(file))
    groups = list(dict.fromkeys(row["group"] for rows in streams.values() for row in rows))
    print("| stream | trials | " + " | ".join(groups) + " | all | at the end | usual policy |")
    print("|---|---|" + "---|" * (len(groups) + 3))
    columns = []
    for name, rows in streams.items():
        def share(group=None, column="success", rows=rows):
            return fmean(int(row[column]) for row in rows if group in (None, row["group"]))

        values = [*map(share, groups), share(), share(column="success_at_end")]
        columns.append(values)
        cells = [name, str(len(rows)), *(f"{value:.2f}" for value in values)]
        print("| " + " | ".join([*cells, str(usual_policies(rows))]) + " |")
    means = [interval(values) for values in zip(*columns)]
    per_stream = fmean(map(len, streams.values()))
    usual = fmean(map(usual_policies, streams.values()))
    print("| " + " | ".join(["mean", f"{per_stream:g}", *means, f"{usual:g}"]) + " |")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1:])
