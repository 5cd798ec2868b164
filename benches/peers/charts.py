"""Draws the charts of docs/results/benchmarks.md from kept data, into docs/media/benchmarks: charts.py.

Figures of other projects, and of ours those that only pages have, are in
docs/results/benchmarks.csv. Results of our learners are read from docs/results/efficiency and
docs/results/table1; studies of `covers-sac` are drawn where their folders exist. Equal data give
equal bytes.
(pip install matplotlib)
"""

import csv
import math
import re
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

DOCS = Path(__file__).resolve().parents[2] / "docs"
KEPT = DOCS / "results"
MEDIA = DOCS / "media" / "benchmarks"
GROUPS = ["Goal Reach", "Drawer Close", "Button Press", "Plate Slide"]
STEPS_OF_A_DECISION = 10  # control steps, in all of our runs

INK = "#1b1f24"
GREY = "#8a8f98"
BLUE, SKY, ORANGE = "#0072b2", "#56b4e9", "#e69f00"
VERMILION, GREEN, PURPLE = "#d55e00", "#009e73", "#cc79a7"

plt.rcParams.update({
    "svg.hashsalt": "covers",
    "svg.fonttype": "none",  # half the size of paths
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK,
    "axes.labelcolor": INK,
})


def kept(chart):
    """Rows of a chart: {(item, system): value}, infinite where success never stays."""
    with open(KEPT / "benchmarks.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["chart"] == chart]
    return {(row["item"], row["system"]): number(row["value"]) for row in rows}


def report(path):
    """Rows of a table of `covers report`, or none where the study is not kept."""
    if not (KEPT / path).exists():
        return []
    with open(KEPT / path, newline="") as file:
        return list(csv.DictReader(file))


def number(text):
    return math.inf if text == "never" else float(text)


def interval(cell):
    """Value, low and high of a cell such as `0.995 [0.991, 0.998]` or `50000 [32000, never]`; a lone value has an empty interval."""
    numbers = [number(word) for word in re.findall(r"never|[\d.]+", cell)]
    return numbers if len(numbers) == 3 else [numbers[0]] * 3


def method(row):
    """Name of a report's method, without the mark of a footnote."""
    return row["method"].split(" (")[0]


def log_axis(axes, label):
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(label)


def beside(axes, y, text):
    """A word to the right of a row."""
    axes.text(1.03, y, text, transform=axes.get_yaxis_transform(), va="center", fontsize=8.5)


def rows_axis(axes, labels, gap=0.6):
    """Rows from top to bottom, with a line in each."""
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 1 + gap, -gap)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="both", color="#e4e6e9", linewidth=0.8)


def mark(axes, x, y, style, hollow=False, size=6):
    """A mark; the first one of a row is above the later ones that it meets."""
    colour, marker = style
    order = 3 - len(axes.lines) / 1000
    axes.plot([x], [y], marker, color=colour, markersize=size, markerfacecolor="white" if hollow else colour, zorder=order, clip_on=False)


def legend(figure, styles, hollow=()):
    """A legend of marks below the figure: {label: style}."""
    handles = []
    for label, (colour, marker) in styles.items():
        inside = "white" if label in hollow else colour
        handles.append(Line2D([], [], linestyle="none", marker=marker, color=colour, markersize=6, markerfacecolor=inside, label=label))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, handletextpad=0.3, columnspacing=1.4)


def save(figure, name):
    MEDIA.mkdir(parents=True, exist_ok=True)
    figure.savefig(MEDIA / f"{name}.svg", metadata={"Date": None}, facecolor="white")
    plt.close(figure)


def layers():
    data = kept("layers")
    styles = {"covers": (BLUE, "o"), "PyTorch 2.15.0": (VERMILION, "s"), "escnn 1.0.11": (GREEN, "^")}
    panels = {
        "Training, a batch": "training, 2 threads",
        "Inference, a batch": "inference, 2 threads",
        "Inference, one image": "latency, 2 threads",
        "Initialisation, once (1 thread)": "initialisation, 1 thread",
    }
    networks = ["reference", "narrow", "pooled", "wide"]
    figure, grid = plt.subplots(2, 2, figsize=(7.6, 4.6), sharey=True)
    for axes, (title, task) in zip(grid.flat, panels.items()):
        rows_axis(axes, networks)
        for row, network in enumerate(networks):
            times = {system: data[f"{network}, {task}", system] for system in styles}
            axes.plot([min(times.values()), max(times.values())], [row, row], color=GREY, linewidth=1)
            for system, style in styles.items():
                mark(axes, times[system], row, style)
            ours, *peers = times.values()
            beside(axes, row, " / ".join(f"{peer / ours:.1f}" for peer in peers))
        axes.set_title(title, loc="left")
        log_axis(axes, "ms, 2 threads" if "2 threads" in task else "ms, 1 thread")
    legend(figure, {system.split()[0]: style for system, style in styles.items()})
    figure.text(0.99, 0.985, "at the right: time of PyTorch / escnn divided by ours", ha="right", va="top", fontsize=8.5)
    figure.tight_layout(rect=(0, 0.06, 1, 0.96), w_pad=2.5)
    save(figure, "layers")


def environments():
    data = kept("environments")
    styles = {
        "covers, hand": (SKY, "o"),
        "covers, sawyer": (BLUE, "o"),
        "EnvPool 1.2.5": (VERMILION, "s"),
        "EnvPool 1.2.5, no images": (VERMILION, "s"),
        "Meta-World 3.1.1": (GREEN, "^"),
        "Meta-World 3.1.1, plain rendering": (PURPLE, "D"),
    }
    panels = {
        "State only": "state only",
        "With an image of 64 x 64 at every step": "images",
        "With an image at every step, called from Python (EnvPool: no image)": "images in Python",
    }
    figure, grid = plt.subplots(3, 1, figsize=(7.6, 6.4), sharex=True)
    for axes, (title, scene) in zip(grid, panels.items()):
        rows_axis(axes, GROUPS)
        for row, group in enumerate(GROUPS):
            here = [system for system in styles if (f"{group}, {scene}", system) in data]
            for place, system in enumerate(here):
                mark(axes, data[f"{group}, {scene}", system], row + 0.13 * (place - (len(here) - 1) / 2), styles[system], size=5)
        axes.set_title(title, loc="left")
        log_axis(axes, "")
    grid[-1].set_xlabel("control steps per second, one thread")
    shown = {
        "covers, hand": "covers, hand",
        "covers, sawyer": "covers, Sawyer arm",
        "EnvPool 1.2.5": "EnvPool",
        "Meta-World 3.1.1": "Meta-World",
        "Meta-World 3.1.1, plain rendering": "Meta-World, plain rendering",
    }
    legend(figure, {label: styles[system] for system, label in shown.items()})
    figure.tight_layout(rect=(0, 0.045, 1, 1))
    save(figure, "environments")


def transport():
    data = kept("transport")
    styles = {"covers": (BLUE, "o"), "POT 0.9.7": (VERMILION, "s")}
    sizes = [item for item, system in data if system == "covers"]
    figure, axes = plt.subplots(figsize=(7.6, 2.9))
    rows_axis(axes, sizes)
    for row, size in enumerate(sizes):
        ours, theirs = (data[size, system] for system in styles)
        axes.plot([ours, theirs], [row, row], color=GREY, linewidth=1)
        mark(axes, ours, row, styles["covers"])
        mark(axes, theirs, row, styles["POT 0.9.7"])
        beside(axes, row, f"{data[size, 'POT / covers']}")
    beside(axes, -1, "POT / covers")
    axes.set_ylabel("points")
    log_axis(axes, "ms for one exact distance, 128 dimensions, one thread")
    legend(figure, {system.split()[0]: style for system, style in styles.items()})
    figure.tight_layout(rect=(0, 0.09, 1, 1))
    save(figure, "transport")


# our learners alone on a group: method, label, folder of its study, style
ALONE = [("equi", "COVERS (PPO)", "{}", (BLUE, "o")), ("covers-sac", "COVERS-SAC", "sac-{}", (ORANGE, "o"))]
PEERS = {"MWM": (VERMILION, "s"), "DreamerV2": (GREEN, "^"), "TD-MPC2": (PURPLE, "D")}
STUDIES = {"Goal Reach": "reach", "Drawer Close": "drawer", "Button Press": "button", "Plate Slide": "plate"}
MOST_STEPS = 3e6


def alone(group):
    """Our learners on one group, in control steps: label, style, first crossing, where success stays, the interval of that."""
    for name, label, folder, style in ALONE:
        for row in report(f"efficiency/{folder.format(STUDIES[group])}/efficiency.csv"):
            if method(row) == name:
                first, *_ = interval(row["decisions to 0.9: median"])
                stays = interval(row["decisions until it stays at 0.9: median"])
                first, stays, *bounds = (STEPS_OF_A_DECISION * value for value in (first, *stays))
                yield label, style, first, stays, bounds


def learners(group, peers):
    """Our learners and the peers on one group."""
    yield from alone(group)
    for name, style in PEERS.items():
        label = name + (" (states)" if name == "TD-MPC2" else "")
        yield label, style, peers[f"{group}, first", name], peers[f"{group}, stays", name], None


def span(axes, low, high, y, **line):
    """A line from low to high, or an arrow to the edge of the chart where there is no end."""
    axes.plot([low, min(high, MOST_STEPS)], [y, y], **line)
    if math.isinf(high):
        mark(axes, MOST_STEPS, y, (line["color"], ">"), size=5)


def learning():
    peers = kept("learning")
    rows = {group: list(learners(group, peers)) for group in GROUPS}
    figure, axes = plt.subplots(figsize=(7.6, 0.23 * sum(map(len, rows.values())) + 1.7))
    y, labels = 0, {}
    for group, contenders in rows.items():
        axes.text(-0.21, y, group, transform=axes.get_yaxis_transform(), ha="right", va="center", fontweight="bold")
        for label, style, first, stays, bounds in contenders:
            if bounds:
                span(axes, *bounds, y, color=style[0], linewidth=4, alpha=0.35, solid_capstyle="butt")
            span(axes, first, stays, y, color=style[0], linewidth=1)
            if math.isfinite(stays):
                mark(axes, stays, y, style)
            mark(axes, first, y, style, hollow=True)
            labels[y] = label
            y += 1
        y += 0.7
    axes.set_yticks(list(labels), labels.values())
    axes.set_ylim(y - 1, -0.7)
    axes.tick_params(axis="y", length=0)
    axes.grid(color="#e4e6e9", linewidth=0.8)
    axes.set_xlim(5e3, MOST_STEPS)
    log_axis(axes, "control steps until success is at 0.9; bands: 95 % intervals")
    entries = {"first at 0.9": (INK, "o"), "at 0.9 from there on": (INK, "o"), "never (or no upper end)": (INK, ">")}
    legend(figure, entries, hollow=["first at 0.9"])
    figure.tight_layout(rect=(0, 0.045, 1, 1))
    save(figure, "learning")


# methods of the stream: preset, label, and the table that has it
STREAM = [
    ("covers", "COVERS", "table1"),
    ("covers", "COVERS, with close-ups", "efficiency/stream"),
    ("covers-sac", "COVERS-SAC", "efficiency/sac-stream"),
    ("covers-gt", "COVERS, told the group (COVERS-GT)", "table1"),
    ("equi-sac", "COVERS with SAC (equi-sac)", "table1"),
    ("covers-cnn", "ordinary networks (COVERS-CNN)", "table1"),
    ("covers-cnn-slim", "ordinary, fewer parameters (slim)", "table1"),
    ("3rl", "3RL", "table1"),
    ("clear", "CLEAR", "table1"),
    ("clear-bc", "CLEAR with cloning (clear-bc)", "table1"),
    ("cnn", "one ordinary policy (CNN)", "table1"),
    ("equi", "one equivariant policy (Equi)", "table1"),
]


def stream():
    rows = []
    for name, label, folder in STREAM:
        found = [row for row in report(f"{folder}/seeds.csv") if method(row) == name]
        rows += [(name, f"{label}, {row['seeds']} seeds", folder, interval(row["mean"])) for row in found]
    results = [row for row in report("table1/results.csv") if " in the paper" in row["method"]]
    paper = {row["method"].split(" in the paper")[0]: number(row["average"].split(" /")[0]) for row in results}
    figure, axes = plt.subplots(figsize=(7.6, 0.27 * len(rows) + 1.4))
    rows_axis(axes, [label for _, label, _, _ in rows])
    for y, (name, _, folder, (mean, low, high)) in enumerate(rows):
        axes.plot([low, high], [y, y], color=BLUE, linewidth=4, alpha=0.35, solid_capstyle="butt")
        mark(axes, mean, y, (BLUE, "o"))
        beside(axes, y, f"{mean:.3f}")
        if name in paper and folder == "table1":
            mark(axes, paper[name], y, (VERMILION, "D"), hollow=True)
    axes.axvline(paper["covers"], color=VERMILION, linewidth=1, linestyle=(0, (4, 3)))
    axes.text(paper["covers"], -1, f"COVERS in the paper: {paper['covers']}", ha="center", va="center", fontsize=8.5)
    axes.set_xlim(0, 1)
    axes.set_xlabel("mean success over the four groups after the stream")
    entries = {"ours, with the 95 % interval over seeds": (BLUE, "o"), "the paper, in its own scenes": (VERMILION, "D")}
    legend(figure, entries, hollow=["the paper, in its own scenes"])
    figure.tight_layout(rect=(0, 0.065, 0.97, 1))
    save(figure, "stream")


def assignment():
    data = kept("assignment")
    styles = {"covers, evidence": (BLUE, "o"), "paper's rule, threshold 1.0": (VERMILION, "s")}
    wrong = ", rounds learnt by the wrong policy"
    kinds = [item.removesuffix(wrong) for item, system in data if item.endswith(wrong) and system == "covers, evidence"]
    figure, axes = plt.subplots(figsize=(7.6, 5.4))
    rows_axis(axes, kinds)
    for row, kind in enumerate(kinds):
        shares = [data[kind + wrong, system] for system in styles]
        axes.plot(shares, [row, row], color=GREY, linewidth=1)
        for share, style in zip(shares, styles.values()):
            mark(axes, share, row, style)
        exact = " / ".join(f"{data[f'{kind}, exact worlds', system]:.0f}" for system in styles)
        beside(axes, row, exact)
    beside(axes, -1, "exact, %")
    axes.set_xlim(-2, 95)
    axes.set_xlabel("% of rounds that trained the wrong policy")
    legend(figure, {"covers": styles["covers, evidence"], "the paper's rule: W1 of at most 1.0": styles["paper's rule, threshold 1.0"]})
    figure.tight_layout(rect=(0, 0.045, 0.99, 1))
    save(figure, "assignment")


for draw in (layers, environments, transport, learning, stream, assignment):
    draw()
