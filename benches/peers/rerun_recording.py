"""Reads a recording with Rerun's own package and compares it with the tables of the run.

usage: python rerun_recording.py RUN FILE, after `covers-rerun RUN --out FILE`, for a finished run of a method that holds
distances to those of permutations, as `covers` does (pip install rerun-sdk==0.36.3)

Of the stream every figure is compared. Of episodes: that every decision has its actions, its reward in [0, 1] and its pictures, that
pictures fit the camera above them, and that everything on the table has a place from the first decision on.
"""

import csv
import math
import struct
import sys
from pathlib import Path

from rerun.experimental import RrdReader

run, file = Path(sys.argv[1]), RrdReader(sys.argv[2])
VIEWS = ("table/camera/raw", "mask", "seen")
PNG = b"\x89PNG\r\n\x1a\n"


def points(chunks, place, timeline, component):
    """Pairs (moment, values) of a component that changes with time, in order."""
    found = []
    for chunk in chunks:
        if chunk.entity_path == place and not chunk.is_static:
            batch = chunk.to_record_batch()
            names = batch.schema.names
            if timeline in names and component in names:
                found += zip(batch[timeline].to_pylist(), batch[component].to_pylist())
    return sorted((moment, value) for moment, value in found if value)


def rows(name):
    with open(run / name, newline="") as table:
        return list(csv.DictReader(table))


def number(cell):
    value = float(cell) if cell else math.nan
    return value if math.isfinite(value) else None


def compare(place, component, expected):
    """`expected` are triples (rollouts, decisions of the stream, value)."""
    for timeline, moments in (("rollouts", 0), ("stream", 1)):
        got = points(chunks, f"/stream/{place}", timeline, component)
        want = sorted((row[moments], [row[2]]) for row in expected)
        assert got == want, (place, timeline, got[:3], want[:3])
    return len(expected)


chunks = file.stream().to_chunks()
metrics = rows("metrics.csv")
ends = [int(row["decisions"]) for row in metrics]
begins = [0, *ends[:-1]]
compared = compare("group", "StateChange:state", [(k, begins[k], row["group"]) for k, row in enumerate(metrics)])
compared += compare("policy", "StateChange:state", [(k, begins[k], f"policy {row['policy']}") for k, row in enumerate(metrics)])
for figure in ("reward", "success"):
    known = [(k + 1, ends[k], number(row[figure])) for k, row in enumerate(metrics)]
    compared += compare(figure, "Scalars:scalars", [point for point in known if point[2] is not None])
# COVERS holds a distance to the largest one of its permutations
for place, column in (("distance", "distances"), ("threshold", "null_maxima")):
    cells = [row[column].split(";") for row in metrics]
    for policy in range(max(map(len, cells))):
        known = [(k + 1, ends[k], number(cell[policy])) for k, cell in enumerate(cells) if policy < len(cell)]
        compared += compare(f"{place}/{policy}", "Scalars:scalars", [point for point in known if point[2] is not None])
scores = rows("evaluation.csv")
groups = sorted({row["group"] for row in scores})
for group in groups:
    by_time = {}
    for row in scores:
        if row["group"] == group:
            by_time.setdefault((int(row["rollouts"]), int(row["decisions"])), []).append(float(row["success"]))
    known = [(*moment, sum(successes) / len(successes)) for moment, successes in by_time.items()]
    compared += compare(f"evaluation/{group}", "Scalars:scalars", known)


def moments(place, component):
    return [moment for moment, _ in points(chunks, place, "decision", component)]


def resolution(place):
    """Pixels of the pinhole of a place, which is static."""
    [batch] = [
        chunk.to_record_batch()
        for chunk in chunks
        if chunk.entity_path == place and chunk.is_static and "Pinhole:resolution" in chunk.to_record_batch().schema.names
    ]
    return batch["Pinhole:resolution"].to_pylist()[0][0]


def check_episode(place):
    rewards = points(chunks, f"{place}/reward", "decision", "Scalars:scalars")
    count = len(rewards)
    assert count > 0 and [moment for moment, _ in rewards] == list(range(1, count + 1)), place
    assert all(0 <= value[0] <= 1 for _, value in rewards), place
    for part in ("x", "y", "z", "fingers"):
        assert moments(f"{place}/action/{part}", "Scalars:scalars") == list(range(count)), (place, part)
    for view in VIEWS:
        pictures = points(chunks, f"{place}/{view}", "decision", "EncodedImage:blob")
        assert [moment for moment, _ in pictures] == list(range(count + 1)), (place, view)
        pngs = [bytes(picture[0]) for _, picture in pictures]
        assert all(png.startswith(PNG) for png in pngs), (place, view)
        if view == VIEWS[0]:
            sides = {struct.unpack(">II", png[16:24]) for png in pngs}
            assert sides == {tuple(map(int, resolution(f"{place}/table/camera")))}, (place, sides)
    for part in ("arm", "table"):
        solids = {chunk.entity_path for chunk in chunks if chunk.entity_path.startswith(f"{place}/table/{part}/")}
        assert solids, (place, part)
        for solid in solids:
            assert moments(solid, "Transform3D:translation")[:1] == [0], solid


recorded = sorted({tuple(chunk.entity_path.split("/")[1:3]) for chunk in chunks if chunk.entity_path.endswith("/reward")} - {("stream", "reward")})
for group, element in recorded:
    assert group in groups, group
    check_episode(f"/{group}/{element}")
assert recorded and len(recorded) % 4 == 0, recorded
[blueprint] = file.blueprints()
print(f"{compared} figures of the stream and {len(recorded)} episodes agree; the layout is {blueprint.application_id}'s")
