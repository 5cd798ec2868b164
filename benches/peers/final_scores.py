"""Scores of finished runs after the stream, and tests over seeds, for the scripts beside this one."""

import csv
import itertools
import json
import sys
from statistics import fmean

from scipy import stats

PLACEMENTS = 3  # `evaluation.seed` of the plans


def scores_of(folder):
    """Rows of a finished run's evaluation after the stream."""
    if not (folder / "summary.json").exists():
        sys.exit(f"{folder} is not finished")
    experiment = json.loads((folder / "experiment.json").read_text())
    if experiment["evaluation"]["seed"] != PLACEMENTS:
        sys.exit(f"{folder} was not evaluated on the placements of the plan")
    with open(folder / "evaluation.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    last = max(int(row["rollouts"]) for row in rows)
    return [row for row in rows if int(row["rollouts"]) == last]


def own(row):
    """Success of the policy that served the group in most of its rollouts."""
    return float(row["own_success"])


def interval(values):
    """A mean, with its 95 % interval by Student's t unless all values are equal."""
    if len(set(values)) < 2:
        return f"{fmean(values):.3f}"
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1)
    return f"{fmean(values):.3f} ± {half:.3f}"


def p_values(values, others):
    """p-values of Welch's t-test and of a permutation test, or `None` where they are undefined."""
    if min(len(values), len(others)) < 2 or len({*values}) == len({*others}) == 1:
        return None, None
    both, count = [*values, *others], len(values)
    total = sum(both)
    observed = abs(sum(values) / count - sum(others) / len(others))
    splits = itertools.combinations(both, count)
    gaps = (abs(sum(part) / count - (total - sum(part)) / len(others)) for part in splits)
    reached = [gap >= observed - 1e-12 for gap in gaps]
    return stats.ttest_ind(values, others, equal_var=False).pvalue, fmean(reached)


def holm(values):
    """p-values of several tests, adjusted by Holm's method; undefined ones stay undefined."""
    defined = sorted(value for value in values if value is not None)
    adjusted, largest = {}, 0.0
    for rank, value in enumerate(defined):
        largest = max(largest, min(1.0, (len(defined) - rank) * value))
        adjusted.setdefault(value, largest)
    return [adjusted.get(value) for value in values]


def text_of(p_value):
    """A p-value for a table."""
    return "-" if p_value is None else f"{p_value:.1e}"
