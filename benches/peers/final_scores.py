"""Scores of finished runs after the stream, for the scripts beside this one."""

import csv
import json
import sys

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
