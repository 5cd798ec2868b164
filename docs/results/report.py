"""Curves and tables of runs: report.sh RUN..."""

import csv
import sys
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot

GROUPS = ["goal-reach", "button-press", "drawer-close", "plate-slide"]
COLORS = dict(zip(GROUPS, ["tab:green", "tab:red", "tab:blue", "tab:orange"]))
# Table 1 of the paper, COVERS: success and reward.
PAPER = {
    "goal-reach": (0.98, 484),
    "button-press": (0.87, 323),
    "drawer-close": (0.82, 400),
    "plate-slide": (0.97, 344),
}


def table(path):
    """The rows of a CSV file, numbers as numbers."""

    def number(text):
        try:
            return float(text)
        except ValueError:
            return text

    with open(path) as file:
        return [{key: number(value) for key, value in row.items()} for row in csv.DictReader(file)]


class Run:
    """What one folder says."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.metrics = table(self.folder / "metrics.csv")
        self.timings = table(self.folder / "timings.csv")
        self.scores = table(self.folder / "evaluation.csv")
        self.visits = list(self.cut_into_visits())
        self.final = [s for s in self.scores if s["rollout"] == self.scores[-1]["rollout"]]

    def cut_into_visits(self):
        """Lists of rows of metrics with the same group."""
        start = 0
        rows = self.metrics
        for i in range(1, len(rows) + 1):
            if i == len(rows) or rows[i]["group"] != rows[start]["group"]:
                yield rows[start:i]
                start = i

    def returns(self):
        """The visits of groups that were there before, and the policy that each group had at first."""
        home = {}
        for visit in self.visits:
            group = visit[0]["group"]
            if group in home:
                yield visit, home[group]
            home.setdefault(group, visit[-1]["policy"])

    def learning_curve(self, group):
        """Rollouts that `group` had had, and its success, in each evaluation while it ran."""
        had = 0
        for row in self.metrics:
            if row["group"] == group:
                had += 1
                if figures := self.evaluation(row["rollout"], group):
                    yield had, figures[0]

    def evaluation(self, rollout, group):
        """Success and reward of `group` in the evaluation after `rollout`, variants alike; none where there was none."""
        rows = [s for s in self.scores if s["rollout"] == rollout and s["group"] == group]
        if rows:
            return np.mean([s["success"] for s in rows]), np.mean([s["reward"] for s in rows])

    def draw(self):
        """Success and reward of each rollout, evaluations of the groups met so far as dots, policies below, the group as background."""
        figure, axes = pyplot.subplots(
            3, 1, sharex=True, figsize=(11, 7), height_ratios=[3, 3, 1], layout="constrained"
        )
        x = [row["decisions"] / 1000 for row in self.metrics]
        before = 0
        for visit in self.visits:
            end = visit[-1]["decisions"] / 1000
            for axis in axes:
                axis.axvspan(before, end, color=COLORS[visit[0]["group"]], alpha=0.15, linewidth=0)
            before = end
        for axis, key in [(axes[0], "success"), (axes[1], "reward")]:
            for visit in self.visits:
                axis.plot(
                    [row["decisions"] / 1000 for row in visit],
                    [row[key] for row in visit],
                    color=COLORS[visit[0]["group"]],
                    linewidth=1,
                )
            axis.set_ylabel(f"{key} of a rollout\n(dots: mean action)")
        for rollout in sorted({score["rollout"] for score in self.scores}):
            at = self.metrics[int(rollout)]["decisions"] / 1000
            for group in {row["group"] for row in self.metrics[: int(rollout) + 1]}:
                if figures := self.evaluation(rollout, group):
                    for axis, figure_ in zip(axes, figures):
                        axis.plot(at, figure_, "o", color=COLORS[group], markersize=5, markeredgecolor="black")
        axes[1].set_ylim(0, 500)
        axes[0].set_ylim(-0.03, 1.03)
        axes[2].step(x, [row["policy"] for row in self.metrics], where="mid", color="black")
        axes[2].set_ylabel("policy")
        axes[2].set_yticks(sorted({int(row["policy"]) for row in self.metrics}))
        axes[2].set_xlabel("thousand decisions")
        for group in GROUPS:
            axes[0].plot([], [], color=COLORS[group], label=group)
        figure.legend(loc="outside upper center", ncols=4)
        figure.savefig(self.folder / "curves.png", dpi=110)
        pyplot.close(figure)


def groups_of(runs):
    return [group for group in GROUPS if any(s["group"] == group for run in runs for s in run.final)]


def interval(runs, group, key, draws=10000):
    """Percentile interval (95 %) of the mean: seeds are resampled, then variants within each."""
    rng = np.random.default_rng(0)
    values = np.array([[s[key] for s in run.final if s["group"] == group] for run in runs])
    seeds, variants = values.shape
    rows = rng.integers(seeds, size=(draws, seeds, 1))
    columns = rng.integers(variants, size=(draws, seeds, variants))
    return np.percentile(values[rows, columns].mean(axis=(1, 2)), [2.5, 97.5])


def iqm(values):
    """Mean of the middle half."""
    values = np.sort(np.ravel(values))
    cut = len(values) // 4
    return values[cut : len(values) - cut].mean()


def result_table(runs):
    print("| group | episodes | success | 95 % | IQM | at end | reward of 500 | 95 % | paper: success, reward |")
    print("|---|---|---|---|---|---|---|---|---|")
    total = []
    for group in groups_of(runs):
        rows = [s for run in runs for s in run.final if s["group"] == group]
        success, at_end, reward = (np.mean([s[key] for s in rows]) for key in ("success", "success_at_end", "reward"))
        low, high = interval(runs, group, "success")
        worst, best = interval(runs, group, "reward")
        paper = PAPER[group]
        total.append((success, reward))
        print(
            f"| {group} | {sum(s['episodes'] for s in rows):.0f} | {success:.3f} | {low:.3f} to {high:.3f} | "
            f"{iqm([s['success'] for s in rows]):.3f} | {at_end:.3f} | {reward:.1f} | {worst:.1f} to {best:.1f} | {paper[0]:.2f}, {paper[1]} |"
        )
    success, reward = np.mean(total, axis=0)
    print(f"| average | | {success:.3f} | | | | {reward:.1f} | | 0.91, 388 |\n")


def seed_table(runs):
    print(
        "| run | decisions | policies | rollouts of returning groups assigned right | switches noticed at once | "
        "worst loss of success since a group's visit | seconds of learning |"
    )
    print("|---|---|---|---|---|---|---|")
    for run in runs:
        returns = list(run.returns())
        right = [row["policy"] == home for visit, home in returns for row in visit]
        noticed = [visit[0]["policy"] == home for visit, home in returns]
        losses = []
        for group in groups_of(runs):
            ends = [v[-1]["rollout"] for v in run.visits if v[0]["group"] == group]
            after, final = run.evaluation(ends[-1], group), run.evaluation(run.final[0]["rollout"], group)
            if after:
                losses.append(after[0] - final[0])
        print(
            f"| {run.folder.name} | {run.metrics[-1]['decisions']:.0f} | {1 + max(row['policy'] for row in run.metrics):.0f} | "
            f"{sum(right)} of {len(right)} | {sum(noticed)} of {len(noticed)} | {max(losses):+.3f} | "
            f"{sum(row['total'] for row in run.timings):.0f} |"
        )
    print()


def time_table(runs):
    print("| part | seconds | per rollout | share |\n|---|---|---|---|")
    rows = [row for run in runs for row in run.timings]
    total = sum(row["total"] for row in rows)
    parts = ["environments", "inference", "assignment", "update"]
    sums = {part: sum(row[part] for row in rows) for part in parts}
    sums["the rest"] = total - sum(sums.values())
    sums["all"] = total
    for part, seconds in sums.items():
        print(f"| {part} | {seconds:.0f} | {seconds / len(rows):.3f} | {100 * seconds / total:.1f} % |")
    print()


def variant_table(runs):
    print("| group | identity | flip x | flip y | half turn |\n|---|---|---|---|---|")
    for group in groups_of(runs):
        cells = []
        for element in ["identity", "flip x", "flip y", "half turn"]:
            rows = [s for run in runs for s in run.final if s["group"] == group and s["element"] == element]
            text = f"{np.mean([s['success'] for s in rows]):.3f}"
            cells.append(text if rows[0]["seen"] == "true" else f"({text})")
        print(f"| {group} | {' | '.join(cells)} |")
    print()


def efficiency_table(runs):
    groups = groups_of(runs)
    print(f"| run | {' | '.join(groups)} |\n|---|{'---|' * len(groups)}")
    for run in runs:
        cells = [", ".join(f"{had}: {success:.2f}" for had, success in run.learning_curve(group)) for group in groups]
        print(f"| {run.folder.name} | {' | '.join(cells)} |")
    print()


if __name__ == "__main__":
    runs = [Run(folder) for folder in sys.argv[1:]]
    for run in runs:
        run.draw()
    result_table(runs)
    variant_table(runs)
    seed_table(runs)
    efficiency_table(runs)
    time_table(runs)
