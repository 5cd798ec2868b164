"""Draws where the layers stand below the machine's roofline (Williams et al. 2009): roofline.py DRIVER FILE.svg [ROUNDS].

One core. The roof is what one large product reaches in PyTorch and what a copy of a large array moves, measured in turn with the
networks of layers.py. Operations are those that are done: two for each multiplication of the folded products, three products a layer in
training but for the gradient in the pictures. Bytes are the least that a pass moves if nothing stays in a cache between layers: every
map read and written once, forward, and in training three times. (pip install torch numpy matplotlib; the driver is the example
`layer_times` of covers-benches.)
"""

import sys
import time
from statistics import median

import matplotlib
import numpy as np
import torch
from driver import Driver

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import NullFormatter, ScalarFormatter

SIDES = {  # of a picture, its batch, the channels of every map; a map has half the side of the last
    "reference": (64, 64, [6, 32, 64, 128, 128]),
    "narrow": (64, 64, [6, 16, 32, 64, 64]),
}
COLOURS = {"reference": "#0072b2", "narrow": "#d55e00"}
MARKS = {"training": "o", "inference": "s"}


def seconds(run):
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def product(dtype=torch.float32):
    """Operations a second of one large product."""
    a, b = torch.rand(1024, 1024).to(dtype), torch.rand(1024, 1024).to(dtype)
    a @ b
    return 2 * 1024**3 / seconds(lambda: a @ b)


def copy():
    """Bytes a second of a copy that no cache holds, read and written."""
    a = np.ones(1 << 25)
    b = np.empty_like(a)
    np.copyto(b, a)
    return 2 * a.nbytes / seconds(lambda: np.copyto(b, a))


def moved(name, task):
    """Least bytes of a pass over a batch."""
    side, batch, channels = SIDES[name]
    maps = [(side >> layer) ** 2 * count for layer, count in enumerate(channels)]
    once = sum(before + after for before, after in zip(maps, maps[1:]))
    return 4 * batch * once * (3 if task == "training" else 1)


def operations(driver, name, task):
    side, batch, channels = SIDES[name]
    forward = driver.ask(name, "multiplications", 1)[0]
    # a first layer has no input gradient; folding leaves a quarter of the dense network's multiplications
    first = (side // 2) ** 2 * 16 * channels[0] * channels[1] / 4
    return 2 * batch * (3 * forward - first if task == "training" else forward)


def draw(file, roof, bandwidth, points):
    figure, axes = plt.subplots(figsize=(7.2, 4.4))
    intensity = np.logspace(0, 2, 100)
    axes.loglog(intensity, np.minimum(roof, bandwidth * intensity) / 1e9, color="#1b1f24")
    axes.text(intensity[-1], roof / 1e9 * 1.05, f"one large product: {roof / 1e9:.0f} GFLOP/s", ha="right")
    axes.text(2.2, bandwidth * 2 / 1e9, f"a copy: {bandwidth / 1e9:.0f} GB/s", va="top")
    for (name, task), (ops, moved_bytes, elapsed) in points.items():
        x, y = ops / moved_bytes, ops / elapsed / 1e9
        axes.plot(x, y, MARKS[task], color=COLOURS[name], label=f"{name}, {task}: {y:.0f} GFLOP/s")
        print(f"{name:<10} {task:<10} {1e3 * elapsed:7.2f} ms {x:6.1f} operations a byte {y:6.1f} GFLOP/s {1e9 * y / roof:5.2f} of the product")
    axes.set_ylim(10, 1.4 * roof / 1e9)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("operations a byte")
    axes.set_ylabel("GFLOP/s, one core")
    axes.legend(frameon=False, loc="lower right")
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(file, metadata={"Date": None})


def main():
    torch.set_num_threads(1)
    driver, file, rounds = Driver(sys.argv[1]), sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 20
    pairs = [(name, task) for name in SIDES for task in MARKS]
    times, products, copies = {pair: [] for pair in pairs}, [], []
    for _ in range(rounds):
        products.append(product())
        copies.append(copy())
        for name, task in pairs:
            times[name, task].append(1e-3 * driver.ask(name, task, 1)[0])
    points = {
        (name, task): (operations(driver, name, task), moved(name, task), median(elapsed)) for (name, task), elapsed in times.items()
    }
    draw(file, median(products), median(copies), points)
    print(f"roof: {median(products) / 1e9:.1f} GFLOP/s, {median(copies) / 1e9:.1f} GB/s, medians of {rounds} rounds, torch {torch.__version__}")


main()
