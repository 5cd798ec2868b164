"""Records W1 between weighted clouds as POT finds it: cluster/tests/golden/pot.json.

pip install numpy POT==0.9.7 && python benches/peers/ot_golden.py cluster/tests/golden/pot.json
"""

import json
import sys

import numpy as np
import ot

rng = np.random.default_rng(20240501)


def cloud(points, dim):
    # eighths have short decimals and are exact in single precision
    return np.round(8 * rng.normal(size=(points, dim))) / 8


def weights(points, zeros=0):
    # integers over their sum; Rust divides again and gets the same bits
    counts = rng.integers(1, 10, size=points)
    counts[:zeros] = 0
    return rng.permutation(counts)


def equal(points):
    return np.ones(points, dtype=int)


def collinear(points, direction):
    return np.round(8 * rng.normal(size=(points, 1))) / 8 * direction


line = np.array([1.0, -2.0, 0.5, 4.0])
twice = np.repeat(cloud(8, 3), 2, axis=0)
problems = {
    "one point each": (cloud(1, 3), equal(1), cloud(1, 3), equal(1)),
    "one point and a weighted cloud": (cloud(1, 5), equal(1), cloud(17, 5), weights(17)),
    "as many, equal weights": (cloud(40, 2), equal(40), cloud(40, 2), equal(40)),
    "fewer, equal weights": (cloud(20, 3), equal(20), cloud(50, 3), equal(50)),
    "more, arbitrary weights": (cloud(45, 3), weights(45), cloud(31, 3), weights(31)),
    "weights with zeros": (cloud(30, 2), weights(30, 9), cloud(24, 2), weights(24, 6)),
    "duplicates within and between": (twice, weights(16), np.vstack([twice[4:], cloud(5, 3)]), equal(17)),
    "integer grid": (np.round(cloud(36, 2)), equal(36), np.round(cloud(36, 2)), equal(36)),
    "collinear": (collinear(25, line), equal(25), collinear(40, line), weights(40)),
    "64 dimensions": (cloud(24, 64), equal(24), cloud(24, 64) + 1, equal(24)),
    "128 dimensions": (cloud(12, 128), weights(12), cloud(20, 128), weights(20, 3)),
}


def record(name, x, a, y, b):
    p, q = a / a.sum(), b / b.sum()
    costs = ot.dist(x, y, metric="euclidean")
    value, log = ot.emd2(p, q, costs, numItermax=10**8, log=True)
    gap = abs(value - log["u"] @ p - log["v"] @ q)
    assert log["warning"] is None and gap <= 1e-12 * costs.max(), (name, gap)
    lists = {"x": x.ravel().tolist(), "a": a.tolist(), "y": y.ravel().tolist(), "b": b.tolist()}
    return {"name": name, "dim": x.shape[1], **lists, "value": value, "gap": gap}


with open(sys.argv[1], "w") as file:
    records = [json.dumps(record(name, *problem), separators=(",", ":")) for name, problem in problems.items()]
    file.write(json.dumps({"POT": ot.__version__, "numpy": np.__version__})[:-1] + ', "problems": [\n')
    file.write(",\n".join(records) + "\n]}\n")
