"""Records the costs of assignments as SciPy finds them: cluster/tests/golden/scipy.json.

pip install numpy==2.4.6 scipy==1.17.1 &&
python benches/peers/assignment_golden.py cluster/tests/golden/scipy.json
"""

import json
import sys

import numpy as np
import scipy
from scipy.optimize import linear_sum_assignment

rng = np.random.default_rng(20261126)
PRICES = [1e3, 1e6, 1e9, 1e12, 1e15, 1e16, 1e18, 1e24, 1e30]
SIZES = [2, 3, 4, 6, 9, 14, 20, 27, 34, 40]


def record(n, blocks, even):
    # rows and columns of one block may be paired, at a cost in ten thousandths
    rows = rng.permutation(np.arange(n) % blocks)
    # each block has as many columns as rows, so that allowed pairs suffice, or any number
    columns = rng.permutation(rows) if even else rng.integers(0, blocks, size=n)
    allowed = rows[:, None] == columns
    drawn = rng.integers(0, 10000, size=(n, n))
    # a block with more rows than columns must use forbidden pairs
    least = sum(max(0, (rows == b).sum() - (columns == b).sum()) for b in range(blocks))
    mixed = np.array(PRICES)[(5 * np.arange(n)[:, None] + 7 * np.arange(n)) % len(PRICES)]
    values = []
    for prices in [*PRICES, mixed]:
        costs = np.where(allowed, drawn / 10000, prices)
        pairs = linear_sum_assignment(costs)
        forbidden = (~allowed[pairs]).sum()
        assert forbidden == least or prices is mixed and forbidden > least, (n, forbidden, least)
        values.append(float(costs[pairs].sum()))
    # prices of pairs that the optimum does not use change nothing
    assert least > 0 or np.ptp(values) == 0, (n, values)
    lists = {"rows": rows.tolist(), "columns": columns.tolist(), "costs": drawn[allowed].tolist()}
    return {**lists, "forbidden": int(least), "values": values}


matrices = [record(n, min(n, blocks), blocks < 5) for n in SIZES for blocks in [3, 4, 5, 6]]
with open(sys.argv[1], "w") as file:
    head = {"scipy": scipy.__version__, "numpy": np.__version__, "prices": PRICES}
    file.write(json.dumps(head)[:-1] + ', "matrices": [\n')
    file.write(",\n".join(json.dumps(m, separators=(",", ":")) for m in matrices) + "\n]}\n")
