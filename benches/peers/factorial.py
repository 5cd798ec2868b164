"""Separates the effect of symmetry from that of a policy per group: factorial.py RUNS_FOLDER.

RUNS_FOLDER holds finished runs of the plan docs/results/plans/factorial-sac.json, in folders
covers-sac-NETWORK-seedN (the learner recognises groups and has a policy for each) and
covers-sac-NETWORK-single-seedN (one policy for everything). The first table has the mean success
of each group after the stream, by the groups' own policies, and the averages over groups by these
and by the policies that the learner chose. The second compares pairs of cells, which differ in one
factor, by Welch's t-test and an exact permutation test over seeds, with p-values that are adjusted
for the number of comparisons by Holm's method.
"""

import re
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean

from final_scores import own, scores_of
from seed_tests import holm, interval, p_values, text_of

NETWORKS = {"d2": "equivariant", "ordinary": "ordinary", "mirrored": "ordinary, mirrored replay"}
POLICIES = {"": "one per group", "-single": "one"}


def runs_of(runs):
    """Scores by cell (network, policies) and seed."""
    scores = defaultdict(dict)
    for folder in sorted(folder for folder in Path(runs).iterdir() if folder.is_dir()):
        name = re.fullmatch(r"covers-sac-(d2|ordinary|mirrored)(|-single)-seed(\d+)", folder.name)
        if not name:
            sys.exit(f"{folder} is not a run of the plan")
        scores[name[1], name[2]][int(name[3])] = scores_of(folder)
    cells = [(network, policies) for network in NETWORKS for policies in POLICIES]
    missing = [cell for cell in cells if cell not in scores]
    if missing:
        sys.exit(f"{runs} has no runs of {missing}")
    if len({tuple(scores[cell]) for cell in cells}) != 1:
        sys.exit(f"the cells of {runs} have different seeds")
    return {cell: scores[cell] for cell in cells}


def name_of(cell):
    """Network and policies of a cell, in words."""
    network, policies = cell
    return [NETWORKS[network], POLICIES[policies]]


def print_row(cells):
    print("| " + " | ".join(cells) + " |")


def main(runs):
    """Prints both tables."""
    scores = runs_of(runs)
    first = next(iter(scores.values()))
    groups = list(dict.fromkeys(row["group"] for run in first.values() for row in run))
    print_row(["network", "policies", *groups, "average (95 % by Student's t)", "lowest seed",
               "average, chosen policies"])
    print("|" + "---|" * (len(groups) + 5))
    averages = {}
    for cell, of_seeds in scores.items():
        averages[cell] = [fmean(map(own, run)) for run in of_seeds.values()]
        rows = [row for run in of_seeds.values() for row in run]
        of_groups = [fmean(own(row) for row in rows if row["group"] == group) for group in groups]
        chosen = [fmean(float(row["success"]) for row in run) for run in of_seeds.values()]
        print_row([*name_of(cell), *(f"{success:.3f}" for success in of_groups),
                   interval(averages[cell]), f"{min(averages[cell]):.3f}", interval(chosen)])

    pairs = [((network, ""), (network, "-single")) for network in NETWORKS]
    pairs += [(("d2", policies), (network, policies)) for policies in POLICIES
              for network in NETWORKS if network != "d2"]
    print()
    print_row(["cell", "other cell", f"difference ({len(first)} seeds each)", "p (Welch's t)",
               "adjusted", "p (permutations of seeds)", "adjusted"])
    print("|" + "---|" * 7)
    tests = [p_values(averages[cell], averages[other]) for cell, other in pairs]
    adjusted = zip(*(holm(of_all) for of_all in zip(*tests)))
    for (cell, other), raw, of_all in zip(pairs, tests, adjusted):
        difference = fmean(averages[cell]) - fmean(averages[other])
        columns = [text_of(value) for pair in zip(raw, of_all) for value in pair]
        print_row([", ".join(name_of(cell)), ", ".join(name_of(other)), f"{difference:+.3f}",
                   *columns])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
