"""Checks the tables of a report against the files of its runs: table.py RUNS_FOLDER TABLES_FOLDER.

RUNS_FOLDER holds finished runs in folders METHOD-seedN (docs/results/data/table.tar.gz), and
TABLES_FOLDER what `covers report` wrote about them (docs/results/table1). Every cell is computed
once more from the files of the runs, by the definitions of docs/results/protocol.md and the
captions of the report, with numpy and scipy and without the code of the report. Cells that differ
are listed, and the exit status is then 1. Not checked are headers, footnotes and the figures of the
paper.

Numbers have to be right to the last digit shown; where they lie halfway, either neighbour will do.
Bounds of bootstrap intervals and p-values of permutations may be off by what chance allows (RANKS,
`permutation_p`).
"""

import csv
import itertools
import json
import math
import re
import sys
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from scipy import stats

DRAWS = 100_000
# The bounds of an interval are the quantiles at 0.025 and 0.975 of 50,000 draws. The ranks of such
# quantiles have a standard error of sqrt(0.025 * 0.975 / 50,000) = 0.0007, and of ours, of twice as
# many draws, 0.0005. A bound has to lie between our quantiles at ranks 0.004 below and above, which
# are 4.7 standard errors of the difference. In success that is 0.02 at most, and draws of half or
# twice as many placements are found out.
RANKS = [[0.021, 0.029], [0.971, 0.979]]
MARGIN = 0.05
SOLVED = 0.9
NOTHING = ["-"]
# a method whose runs all have the same area has no variance
warnings.filterwarnings("ignore", "Precision loss", RuntimeWarning)


def rows_of(path):
    """Rows of a CSV file as dictionaries."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def mean(values):
    """Mean of numbers."""
    return float(np.mean(list(values)))


def heirs_of(row):
    """Policies that those of a run are merged into after a rollout, by policy."""
    heirs = row.get("heirs", "").split(";")
    return {policy: int(heir) for policy, heir in enumerate(heirs) if heir}


def acting(policy, heirs):
    """Policy that acts for one that may have been merged, in several steps perhaps."""
    while policy in heirs:
        policy = heirs[policy]
    return policy


class Run:
    """Files of a run, and what several tables need of them."""

    def __init__(self, folder):
        self.name = folder.name
        self.experiment = json.loads((folder / "experiment.json").read_text())
        self.rollouts = rows_of(folder / "metrics.csv")
        self.heirs = heirs_of(self.rollouts[-1])
        self.scores = rows_of(folder / "evaluation.csv")
        # runs that cannot be asked have no answers
        answers = folder / "recognition.csv"
        self.answers = rows_of(answers) if answers.exists() else []
        self.units = rows_of(folder / "units.csv")
        self.seconds = sum(float(row["total"]) for row in rows_of(folder / "timings.csv"))
        starts = (folder / "provenance.jsonl").read_text().splitlines()
        self.commit = json.loads(starts[-1])["commit"][:10]
        self.groups = [entry["group"] for entry in self.experiment["schedule"]["groups"]]
        # an evaluation is known by the number of rollouts before it
        self.times = sorted({int(row["rollouts"]) for row in self.scores})
        self.decisions = int(self.rollouts[-1]["decisions"])
        self.policies = 1 + max(int(row["policy"]) for row in self.rollouts)
        (learner,) = self.experiment["learner"].values()
        self.has_one_policy = learner["grouping"] == "single"
        self.is_told = learner["grouping"] == "oracle"
        self.alone = [row for row in self.rollouts if row["straddles"] == "false"]
        self.served = Counter((self.acts(row), row["group"]) for row in self.alone)

    def acts(self, row):
        """Policy that acts at the end for that of a row, or None where the row names none."""
        return None if row["policy"] == "" else acting(int(row["policy"]), self.heirs)

    def scored(self, group, time=None):
        """Rows of a group in an evaluation, by default in that after the stream."""
        time = self.times[-1] if time is None else time
        at = [row for row in self.scores if int(row["rollouts"]) == time]
        return [row for row in at if row["group"] == group]

    def score(self, group, time=None, column="success"):
        """Mean over variants of a column of an evaluation, by default of that after the stream."""
        return mean(float(row[column]) for row in self.scored(group, time))

    def average(self, column="success"):
        """Mean over groups of a column of the evaluation after the stream."""
        return mean(self.score(group, column=column) for group in self.groups)

    def visits(self, group):
        """Visits of a group: number of rollouts before each, and when it was over."""
        visits = []
        for number, row in enumerate(self.rollouts):
            # these are the same but for a rollout of two groups
            for shown in [row["group"], row["last_group"]]:
                if not visits or visits[-1][0] != shown:
                    visits.append([shown, number, number + 1])
                visits[-1][2] = number + 1
        return [(first, end) for shown, first, end in visits if shown == group]

    def placements(self):
        """Number of different placements of a group after the stream."""
        (episodes,) = {int(row["episodes"]) for row in self.scored(self.groups[0])}
        distinct = self.experiment["evaluation"].get("distinct_placements")
        return 4 * episodes if distinct else episodes

    def own_policy(self, group):
        """Policy that served a group in most of its rollouts, of equals the first."""
        counts = {policy: self.served[policy, group] for policy, _ in sorted(self.served)}
        return max(counts, key=counts.get)

    def policy_that_belongs(self, group):
        """Own policy of a group, or None where it served another group in more rollouts."""
        own = self.own_policy(group)
        most = max(self.served[own, other] for other in self.groups)
        return own if self.served[own, group] == most else None


# The parts of a cell are texts and numbers. A number is known by its limits, its digits after the
# point and whether it shows a plus sign.


def number(value, digits, sign=False):
    """Part of a cell: a number without chance."""
    return value, value, digits, sign


def drawn(draws, digits):
    """Parts of a cell: the interval of 95 % of draws, nothing where all draws are equal."""
    if np.isclose(draws.min(), draws.max(), rtol=0, atol=1e-12):
        return []
    low, high = [np.quantile(draws, ranks, method="inverted_cdf") for ranks in RANKS]
    return [" [", (*low, digits, False), ", ", (*high, digits, False), "]"]


def agrees(parts, cell):
    """Tells whether a cell says what its parts say, with as many digits."""
    pattern, limits = "", []
    for part in parts:
        if isinstance(part, str):
            pattern += re.escape(part)
        else:
            low, high, digits, sign = part
            point = rf"\.\d{{{digits}}}" if digits else ""
            pattern += ("([+-]" if sign else "(-?") + rf"\d+{point}|never)"
            slack = 0.5 * 10.0**-digits + 1e-9
            limits.append((low - slack, high + slack))
    match = re.fullmatch(pattern, cell)
    values = [float(text.replace("never", "inf")) for text in match.groups()] if match else []
    inside = [low <= value <= high for value, (low, high) in zip(values, limits)]
    return match is not None and all(inside)


def text_of(parts):
    """Text of the parts of a cell, for people."""
    def text(part):
        if isinstance(part, str):
            return part
        low, high, digits, _ = part
        limits = f"{low:.{digits + 2}f}", f"{high:.{digits + 2}f}"
        return limits[0] if low == high else " to ".join(limits)
    return "".join(map(text, parts))


def draw_successes(runs, rng):
    """Successes drawn again in two levels: an array of draws by runs by groups."""
    known = np.array([[run.score(group) for group in run.groups] for run in runs])
    (count,) = {run.placements() for run in runs}
    chosen = known[rng.integers(len(runs), size=(DRAWS, len(runs)))]
    return rng.binomial(count, chosen) / count


def draw_runs(values, rng):
    """Values of whole runs drawn again: an array of draws by runs."""
    return np.array(values)[rng.integers(len(values), size=(DRAWS, len(values)))]


def interquartile_mean(scores):
    """Mean without the lowest and the highest quarter, over the last axis."""
    quarter, rest = divmod(scores.shape[-1], 4)
    assert rest == 0, "a quarter of the scores has to be a whole number"
    return np.sort(scores, axis=-1)[..., quarter:-quarter].mean(axis=-1)


def quantile(values, rank):
    """Quantile of values of which some may be infinite, with linear interpolation."""
    values, place = sorted(values), rank * (len(values) - 1)
    below, above = values[math.floor(place)], values[math.ceil(place)]
    return below if below == above else below + (place - math.floor(place)) * (above - below)


def welch(one, other, level):
    """Welch's t: interval of the difference and p-value; no interval where nothing varies."""
    if np.ptp(one) < 1e-12 and np.ptp(other) < 1e-12:
        return None, float(abs(mean(one) - mean(other)) < 1e-12)
    test = stats.ttest_ind(one, other, equal_var=False)
    return tuple(test.confidence_interval(level)), test.pvalue


def permutation_p(one, other):
    """Share of all divisions of the runs whose means differ as much, and how far it may be off.

    The report has this share of 99,999 random divisions: four standard errors of it, and one
    division more for the runs as they are.
    """
    both = np.array(one + other)
    assert math.comb(len(both), len(one)) <= 200_000, "too many divisions"
    divisions = itertools.combinations(range(len(both)), len(one))
    sums = both[list(divisions)].sum(axis=1)
    gaps = np.abs(sums / len(one) - (both.sum() - sums) / len(other))
    share = mean(gaps >= abs(mean(one) - mean(other)) - 1e-12)
    return share, 4 * math.sqrt(share * (1 - share) / 99_999) + 1e-5


def compared(one, other):
    """Cells of the difference of two methods, by a value of each run: by Welch's t, outcome."""
    difference = mean(one) - mean(other)
    (interval, p), (narrow, _) = welch(one, other, 0.95), welch(one, other, 0.9)
    low, high = narrow or (difference, difference)
    if p < 0.05 and permutation_p(one, other)[0] < 0.05:
        outcome = "above" if difference > 0 else "below"
    else:
        outcome = "equal within 0.05" if -MARGIN < low and high < MARGIN else "not told apart"
    cell = [number(difference, 3, sign=True)]
    if interval:
        cell += [" [", number(interval[0], 3), ", ", number(interval[1], 3), "]"]
    return cell, [outcome]


def own_average(run, column):
    """Mean over groups of what their own policies score, or None where that is not recorded."""
    def score(group, choice):
        chosen = int(choice["policy"]) == run.own_policy(group)
        return choice[column] if chosen else choice.get(f"own_{column}", "")

    scores = [[score(group, choice) for choice in run.scored(group)] for group in run.groups]
    if any("" in of_group for of_group in scores):
        return None
    return mean(mean(map(float, of_group)) for of_group in scores)


def results(methods, draws):
    """Table of success and reward after the stream."""
    def cell(scores, rewards, interval):
        return [number(mean(scores), 3)] + interval + [" / ", number(mean(rewards), 0)]

    for name, runs in methods.items():
        row = [[name]]
        for index, group in enumerate(runs[0].groups):
            rewards = [run.score(group, column="reward") for run in runs]
            interval = drawn(draws[name][:, :, index].mean(axis=1), 2)
            row.append(cell([run.score(group) for run in runs], rewards, interval))
        scores, rewards = [[run.average(of) for run in runs] for of in ("success", "reward")]
        row.append(cell(scores, rewards, drawn(draws[name].mean(axis=(1, 2)), 2)))
        other = [int(choice["policy"]) != run.own_policy(group)
                 for run in runs for group in run.groups for choice in run.scored(group)]
        own = [[own_average(run, column) for run in runs] for column in ("success", "reward")]
        row.append(NOTHING if None in own[0] else cell(*own, []))
        yield row + [[f"{sum(other)} of {len(other)}"]]


def training_success(run):
    """Success in the stream by decisions: a rollout counts for those thrown away before it, too."""
    weights = np.diff([0] + [int(row["decisions"]) for row in run.rollouts])
    return np.average([float(row["success"]) for row in run.rollouts], weights=weights)


def forgetting(run):
    """Best success in an earlier evaluation less that after the stream, but for its last group."""
    groups = [group for group in run.groups if run.visits(group)[-1][1] < len(run.rollouts)]
    best = {group: max(run.score(group, time) for time in run.times[:-1]) for group in groups}
    return mean(best[group] - run.score(group) for group in groups)


def forgetting_since_visit(run):
    """Success after the last visit less that after the stream, but for the stream's last group."""
    ends = {group: run.visits(group)[-1][1] for group in run.groups}
    return mean(run.score(group, end) - run.score(group)
                for group, end in ends.items() if end < len(run.rollouts))


def backward_transfer(run):
    """Change of success in the pauses between visits, to the last evaluation before the next."""
    changes = []
    for group in run.groups:
        visits = run.visits(group)
        pauses = []
        for (_, end), (begin, _) in zip(visits, visits[1:]):
            times = [time for time in run.times if end < time <= begin]
            if times:
                pauses.append(run.score(group, max(times)) - run.score(group, end))
        if pauses:
            changes.append(mean(pauses))
    return mean(changes)


def forward_transfer(run):
    """Success before a group was seen less that before the stream, but for the first group."""
    starts = {group: run.visits(group)[0][0] for group in run.groups}
    last = {group: max(time for time in run.times if time <= start)
            for group, start in starts.items() if start > 0}
    return mean(run.score(group, time) - run.score(group, 0) for group, time in last.items())


def assignment(run):
    """Share of rollouts that went to the first policy opened for their group, also of returns.

    A merged policy counts as its heir, which belongs to the group of the first policy of all those
    that it acts for.
    """
    opened, heirs, right, returns = {}, {}, [], []
    for count, row in enumerate(run.rollouts):
        if row["straddles"] == "false":
            policy = int(row["policy"])
            opened.setdefault(policy, row["group"])
            first = [of for of in sorted(opened) if opened[of] == row["group"]][:1]
            served = [of for of in sorted(opened) if acting(of, heirs) == acting(policy, heirs)]
            right.append(first == served[:1])
            if count >= run.visits(row["group"])[0][1]:
                returns.append(right[-1])
        heirs = heirs_of(row)
    return mean(right), mean(returns)


def dormant(run):
    """Share of dormant units after the stream."""
    rows = [row for row in run.units if int(row["rollouts"]) == run.times[-1]]
    return sum(int(row["dormant"]) for row in rows) / sum(int(row["units"]) for row in rows)


def seeds(methods, draws):
    """Table of figures over seeds."""
    def from_to(counts):
        low, high = min(counts), max(counts)
        return [f"{low}" if low == high else f"{low} to {high}"]

    for name, runs in methods.items():
        def over_runs(figure, runs=runs):
            return [number(mean(map(figure, runs)), 3)]

        scores = np.array([run.score(group) for run in runs for group in run.groups])
        again = draws[name].reshape(DRAWS, -1)
        row = [[name], [str(len(runs))], from_to([run.decisions for run in runs])]
        row.append([number(scores.mean(), 3)] + drawn(again.mean(axis=1), 3))
        row.append([number(interquartile_mean(scores), 3)] + drawn(interquartile_mean(again), 3))
        row.append(over_runs(lambda run: run.average("success_at_end")))
        row += map(over_runs, [training_success, forgetting, forgetting_since_visit,
                               backward_transfer, forward_transfer])
        if runs[0].has_one_policy:
            row += [NOTHING] * 2
        else:
            row += [[number(mean(shares), 3)] for shares in zip(*map(assignment, runs))]
        row.append(from_to([run.policies for run in runs]))
        count = sum(len(run.rollouts) for run in runs)
        row.append([f"{count - sum(len(run.alone) for run in runs)} of {count}"])
        yield row + [over_runs(dormant), [number(mean(run.seconds for run in runs), 0)]]


def comparisons(methods, draws):
    """Table of the first method against the others."""
    def p_cell(low, high):
        if math.isnan(low):
            return NOTHING
        return ["< 0.0001"] if high < 0.0001 else [(low, high, 4, False)]

    first, *others = methods
    one = [run.average() for run in methods[first]]
    for name in others:
        other = [run.average() for run in methods[name]]
        difference, outcome = compared(one, other)
        p = welch(one, other, 0.95)[1]
        share, error = permutation_p(one, other)
        gaps = draws[first].mean(axis=(1, 2)) - draws[name].mean(axis=(1, 2))
        # by pairs of runs in each group, where ties count half: rliable's definition
        pairs = [(run.score(group), opponent.score(group)) for group in methods[first][0].groups
                 for run in methods[first] for opponent in methods[name]]
        better = mean(0.5 + np.sign(own - its) / 2 for own, its in pairs)
        interval = drawn(gaps, 3)
        interval = ["["] + interval[1:] if interval else [NOTHING[0]]
        # without any spread there is no test by Welch's t
        p = p if len(difference) > 1 else math.nan
        yield [[name], difference, p_cell(p, p), p_cell(share - error, share + error), interval,
               [number(better, 2)], outcome]


def visits(methods, draws):
    """Table of success after each visit."""
    for name, runs in methods.items():
        row = [[name]]
        for group in runs[0].groups:
            scores = [[run.score(group, end) for _, end in run.visits(group)] for run in runs]
            parts = [[", ", number(mean(visit), 2)] for visit in zip(*scores, strict=True)]
            row.append(sum(parts, [])[1:])
        yield row


def learning(run, group):
    """Area under the curve of a group, decisions to 0.9 and until it stays there."""
    taken = np.diff([0] + [int(row["decisions"]) for row in run.rollouts])
    own = taken * np.array([row["group"] == group for row in run.rollouts])
    spent = [int(own[:time].sum()) for time in run.times]
    scores = [run.score(group, time) for time in run.times]
    solved = [score >= SOLVED - 1e-12 for score in scores]
    reached = spent[solved.index(True)] if any(solved) else math.inf
    last_miss = max((index for index, held in enumerate(solved) if not held), default=-1)
    stays = spent[last_miss + 1] if solved[-1] else math.inf
    points, firsts = np.unique(spent, return_index=True)
    steps, heights = np.diff(points), np.array(scores)[firsts]
    return (steps * (heights[1:] + heights[:-1]) / 2).sum() / points[-1], reached, stays


def reached_cells(decisions, rng):
    """Cells of decisions until something: median, 90th percentile, number of seeds."""
    middle, count = quantile(decisions, 0.5), len(decisions)
    draws = np.sort(draw_runs(decisions, rng), axis=1)
    medians = (draws[:, (count - 1) // 2] + draws[:, count // 2]) / 2
    interval = drawn(medians, 0) if math.isfinite(middle) else []
    return [[number(middle, 0)] + interval, [number(quantile(decisions, 0.9), 0)],
            [f"{sum(map(math.isfinite, decisions))} of {count}"]]


def efficiency(methods, draws):
    """Table of how fast methods learn, in each group the fastest first."""
    rng = np.random.default_rng(1)
    first = next(iter(methods))
    for group in methods[first][0].groups:
        known = {name: list(zip(*(learning(run, group) for run in runs)))
                 for name, runs in methods.items()}
        base = mean(known[first][0])
        for name in sorted(methods, key=lambda name: -round(mean(known[name][0]), 9)):
            areas, reached, stays = known[name]
            cells = [NOTHING] * 3
            if name != first:
                difference, outcome = compared(areas, known[first][0])
                transfer = (mean(areas) - base) / (1 - base)
                cells = [difference, [number(transfer, 2, sign=True)], outcome]
            area = [number(mean(areas), 3)] + drawn(draw_runs(areas, rng).mean(axis=1), 3)
            yield [[group], [name], area, *cells, *reached_cells(reached, rng),
                   *reached_cells(stays, rng)]


def variants(methods, draws):
    """Table of success in each variant."""
    for name, runs in methods.items():
        for group in runs[0].groups:
            row = [[name], [group]]
            for rows in zip(*(run.scored(group) for run in runs), strict=True):
                score = number(mean(float(one["success"]) for one in rows), 3)
                row.append([score] if rows[0]["seen"] == "true" else ["(", score, ")"])
            yield row


def recognition(methods, draws):
    """Table of what methods recognise after the stream."""
    def share(run, group, count, policy):
        rows = [row for row in run.answers
                if row["group"] == group and row["episodes"] == str(count)]
        named = [int(row["times"]) for row in rows if run.acts(row) == policy]
        return sum(named) / sum(int(row["times"]) for row in rows)

    for name, runs in methods.items():
        if runs[0].has_one_policy or runs[0].is_told:
            continue
        groups = runs[0].groups
        for count in (1, 4, 20):
            none = mean(share(run, group, count, None) for run in runs for group in groups)
            right = []
            for group in groups:
                own = [run.policy_that_belongs(group) for run in runs]
                right.append(mean(0 if policy is None else share(run, group, count, policy)
                                  for run, policy in zip(runs, own)))
            shares = [*right, mean(right), none]
            yield [[name], [str(count)]] + [[number(one, 3)] for one in shares]


def confusion(methods, draws):
    """Table of the groups that groups are taken for."""
    for name, runs in methods.items():
        if runs[0].has_one_policy or runs[0].is_told:
            continue
        groups = runs[0].groups
        counts = Counter()
        for run in runs:
            own = {group: run.policy_that_belongs(group) for group in groups}
            rows = [("a rollout", row, 1) for row in run.alone]
            rows += [("1 episode", row, int(row["times"])) for row in run.answers
                     if row["episodes"] == "1"]
            for shown, row, times in rows:
                policy = run.acts(row)
                fitting = [group for group in [row["group"], *groups] if own[group] == policy]
                taken_for = [*fitting, "another"][0] if policy is not None else "none"
                counts[shown, row["group"], taken_for] += times
        for shown in ["a rollout", "1 episode"]:
            for group in groups:
                yield [[name], [shown], [group]] + [
                    [str(counts[shown, group, column])] for column in [*groups, "another", "none"]]


def single_runs(methods, draws):
    """Table of single runs."""
    for run in itertools.chain(*methods.values()):
        yield [[run.name], *[[number(run.score(group), 3)] for group in run.groups],
               [number(run.average(), 3)], [number(run.average("reward"), 1)],
               [str(run.policies)], [str(run.decisions)], [number(run.seconds, 0)], [run.commit]]


TABLES = {"results": results, "seeds": seeds, "comparisons": comparisons, "visits": visits,
          "efficiency": efficiency, "variants": variants, "recognition": recognition,
          "confusion": confusion, "runs": single_runs}


# reports leave out those that would be empty (OPTIONAL_REPORT_TABLES in report/src/tables.rs)
OPTIONAL = ["comparisons", "visits", "efficiency", "variants", "recognition", "confusion"]


def table_of(folder, name):
    """Header and rows of a table, without footnote marks and the figures of the paper."""
    with open(folder / f"{name}.csv", newline="") as file:
        rows = [[re.sub(r" \(\d+\)$", "", cell) for cell in row] for row in csv.reader(file)]
    rows = [row for row in rows if not row[0].endswith(" in the paper")]
    own = [index for index, title in enumerate(rows[0]) if title != "in the paper"]
    header, *rows = [[row[index] for index in own] for row in rows]
    return header, rows


def check(folder, name, expected):
    """Prints the cells of a table that differ, and returns how many there are."""
    header, rows = table_of(folder, name)
    lines = [] if len(rows) == len(expected) else [f"{len(rows)} rows, not {len(expected)}"]
    cells = 0
    for row, row_parts in zip(rows, expected):
        for title, cell, parts in zip(header, row, row_parts, strict=True):
            cells += 1
            if not agrees(parts, cell):
                lines.append(f"{', '.join(row[:2])}; {title}: {cell}, not {text_of(parts)}")
    print(f"{name}: {cells} cells, {len(lines)} differ", *lines, sep="\n  ")
    return len(lines)


def main(runs_folder, tables_folder):
    """Checks all tables, and returns whether a cell differs."""
    # a report compares its first method with the others
    methods = {row[0]: [] for row in table_of(Path(tables_folder), "results")[1]}
    folders = [folder for folder in Path(runs_folder).iterdir() if folder.is_dir()]
    for folder in sorted(folders, key=lambda folder: int(folder.name.rsplit("-seed", 1)[1])):
        methods[folder.name.rsplit("-seed", 1)[0]].append(Run(folder))
    rng = np.random.default_rng(0)
    draws = {name: draw_successes(runs, rng) for name, runs in methods.items()}
    absent = [name for name in OPTIONAL if not (Path(tables_folder) / f"{name}.csv").exists()]
    print("not in this report:", ", ".join(absent) or "nothing")
    differing = [check(Path(tables_folder), name, list(table(methods, draws)))
                 for name, table in TABLES.items() if name not in absent]
    return any(differing)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
