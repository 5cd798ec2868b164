"""Reads event files with TensorBoard's own package and compares them with the tables of the run.

usage: python tensorboard_events.py RUN DIR, after `covers report RUN --tensorboard DIR`
(pip install tensorboard)
"""

import csv
import math
import sys
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

run, board = Path(sys.argv[1]), Path(sys.argv[2])
# 0: keep all points of a kind
events = EventAccumulator(str(board / run.resolve().name), size_guidance={"scalars": 0, "images": 0, "histograms": 0})
events.Reload()
tags = events.Tags()
compared = 0


def number(cell):
    words = {"true": 1.0, "false": 0.0}
    try:
        value = words[cell] if cell in words else float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def compare(tag, points):
    """Points are (decisions, value)."""
    global compared
    got = [(e.step, e.value) for e in events.Scalars(tag)] if tag in tags["scalars"] else []
    assert len(got) == len(points), f"{tag}: {len(got)} points, expected {len(points)}"
    for (step, value), (decisions, expected) in zip(got, points):
        assert step == decisions and math.isclose(value, expected, rel_tol=1e-6, abs_tol=1e-30), (tag, step, value, expected)
    compared += len(points)


def rows(name):
    with open(run / name, newline="") as file:
        return list(csv.DictReader(file))


metrics = rows("metrics.csv")
# decisions after so many rollouts, which rows count from 0
after = {0: 0} | {int(row["rollout"]) + 1: int(row["decisions"]) for row in metrics}
PER_POLICY = {"distances", "null_means", "null_maxima", "scores", "p_values", "tail_p_values", "heirs"}


def moment(rollouts):
    return after[max(known for known in after if known <= rollouts)]


for table, prefix in (("metrics.csv", ""), ("timings.csv", "seconds/")):
    for column in set(metrics[0] if not prefix else rows(table)[0]) - {"rollout", "rollouts", "decisions"}:
        cells = [(moment(int(row["rollout"]) + 1), row[column]) for row in rows(table)]
        # a column with several numbers in a cell has one a policy
        if column not in PER_POLICY and not any(";" in cell for _, cell in cells):
            points = [(step, number(cell)) for step, cell in cells]
            compare(prefix + column, [p for p in points if p[1] is not None])
            continue
        several = [(step, cell.split(";")) for step, cell in cells]
        for policy in range(max((len(values) for _, values in several), default=0)):
            points = [(step, number(values[policy])) for step, values in several if policy < len(values)]
            compare(f"{prefix}{column}/policy {policy}", [p for p in points if p[1] is not None])
scores = rows("evaluation.csv")
for group in {row["group"] for row in scores}:
    for figure in ("success", "success_at_end", "reward"):
        by_time = {}
        for row in scores:
            if row["group"] == group:
                by_time.setdefault(moment(int(row["rollouts"])), []).append(float(row[figure]))
        compare(f"evaluation/{group}/{figure}", [(step, sum(v) / len(v)) for step, v in by_time.items()])
[image] = events.Images("variants")
assert image.encoded_image_string == (run / "contact_sheet.png").read_bytes()
for tag in tags["histograms"]:
    for event in events.Histograms(tag):
        assert event.histogram_value.num == sum(event.histogram_value.bucket) > 0
print(f"{compared} scalars of {len(tags['scalars'])} tags, 1 picture and histograms {tags['histograms']} agree")
