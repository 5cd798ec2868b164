"""Intervals and tests over the seeds of runs, for the scripts beside this one."""

import itertools
from statistics import fmean

from scipy import stats


def interval(values):
    """A mean, with its 95 % interval by Student's t unless all values are equal."""
    if len(set(values)) < 2:
        return f"{fmean(values):.3f}"
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1)
    return f"{fmean(values):.3f} ± {half:.3f}"


def p_values(values, others):
    """p-values of Welch's t-test and of a permutation test; `None` for each where it is undefined."""
    if min(len(values), len(others)) < 2:
        return None, None
    both, count = [*values, *others], len(values)
    total = sum(both)
    observed = abs(sum(values) / count - sum(others) / len(others))
    splits = itertools.combinations(both, count)
    gaps = (abs(sum(part) / count - (total - sum(part)) / len(others)) for part in splits)
    reached = [gap >= observed - 1e-12 for gap in gaps]
    # Welch's t has no variance to divide by where all values are equal
    is_constant = len({*values}) == len({*others}) == 1
    welch = None if is_constant else stats.ttest_ind(values, others, equal_var=False).pvalue
    return welch, fmean(reached)


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
