"""Times POT (ot.dist + ot.emd2, double precision) and ours on the same points; run by ot.sh."""

import os
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import ot

DIM = 128
SIZES = [(80, 80), (80, 400), (80, 2000), (1000, 1000), (2000, 2000)]
GROWTH = [125, 250, 500, 1000, 2000, 3000, 4000]
TARGET = 3.0


class Ours:
    """A process that answers requests for distances."""

    def __init__(self, driver):
        pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.process = subprocess.Popen([driver], **pipes)

    def distance(self, files, n, m, repeats=1):
        x, y = files
        self.process.stdin.write(f"{x} {n} {y} {m} {DIM} {repeats}\n")
        self.process.stdin.flush()
        seconds, value, peak = self.process.stdout.readline().split()
        return float(seconds), float(value), int(peak)


def pot(x, y, repeats):
    """Distance by POT and its mean time: uniform weights, no limit on the iterations that would cut an answer short."""
    a, b = np.full(len(x), 1 / len(x)), np.full(len(y), 1 / len(y))
    start = time.perf_counter()
    for _ in range(repeats):
        value = ot.emd2(a, b, ot.dist(x, y, metric="euclidean"), numItermax=10**9)
    return (time.perf_counter() - start) / repeats, float(value)


def clouds(folder, n, m):
    """Two standard normal clouds, the second one shifted by 0.1; single precision, in files and in memory."""
    rng = np.random.default_rng(n * 10007 + m)
    pair = [rng.standard_normal((n, DIM)), rng.standard_normal((m, DIM)) + 0.1]
    files = [f"{folder}/{name}_{n}_{m}.f32" for name in "xy"]
    pair = [points.astype("<f4") for points in pair]
    for points, file in zip(pair, files):
        points.tofile(file)
    return [points.astype(np.float64) for points in pair], files


def compare(ours, folder, n, m):
    """Medians of interleaved rounds, small problems several times a round; the first round warms up and is dropped."""
    (x, y), files = clouds(folder, n, m)
    rounds, repeats = max(5, min(40, 8_000_000 // (n * m))), max(1, 100_000 // (n * m))
    theirs_s, ours_s = [], []
    for _ in range(rounds + 1):
        seconds, expected = pot(x, y, repeats)
        theirs_s.append(seconds)
        seconds, value, _ = ours.distance(files, n, m, repeats)
        ours_s.append(seconds)
    theirs, mine = statistics.median(theirs_s[1:]), statistics.median(ours_s[1:])
    return theirs, mine, abs(value - expected) / expected


def memory(driver, folder, n, m):
    """Peak memory of a fresh process beyond what it has after a tiny problem and the points, over the cost matrix."""
    ours = Ours(driver)
    _, tiny = clouds(folder, 2, 2)
    _, files = clouds(folder, n, m)
    *_, before = ours.distance(tiny, 2, 2)
    *_, after = ours.distance(files, n, m)
    return (after - before - 4 * DIM * (n + m)) / (8 * n * m)


def table(ours, driver, folder):
    print(f"{'n x m':>12} {'POT ms':>9} {'ours ms':>9} {'ratio':>6} {'rel. difference':>16} {'memory / costs':>15}")
    missed = []
    for n, m in SIZES:
        theirs, mine, difference = compare(ours, folder, n, m)
        extra = memory(driver, folder, n, m) if n * m > 500_000 else None
        shown = f"{extra:15.2f}" if extra else " " * 15
        print(f"{n:>6} x {m:<4}{1e3 * theirs:>9.3f} {1e3 * mine:>9.3f} {theirs / mine:>6.1f} {difference:>16.1e} {shown}")
        if theirs / mine < TARGET or difference > 1e-9 or (extra or 0) > 1.5:
            missed.append(f"{n} x {m}")
    print("missed: " + ", ".join(missed) if missed else "every target held")


def growth(ours, folder):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = [(n, *compare(ours, folder, n, n)) for n in GROWTH]
    n, theirs, mine, _ = map(np.array, zip(*rows))
    figure, axes = pyplot.subplots(figsize=(6, 4))
    for name, seconds, marker in [("POT 0.9.7", theirs, "s"), ("cluster", mine, "o")]:
        slope = np.polyfit(np.log(n[2:]), np.log(seconds[2:]), 1)[0]
        axes.loglog(n, 1e3 * seconds, marker=marker, label=f"{name}: n^{slope:.2f} from n = {n[2]}")
        for size, value in zip(n, seconds):
            print(f"{name:>10} n = m = {size:>5} {1e3 * value:>10.2f} ms")
    axes.set(xlabel="points a side", ylabel="milliseconds, one thread", title=f"W1 of two clouds in {DIM} dimensions")
    axes.set_xticks(n, labels=n)
    axes.minorticks_off()
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig("docs/w1_growth.png", dpi=110)


def main(driver, *flags):
    # both sides on one core, so that whatever disturbs the core disturbs both
    os.sched_setaffinity(0, [max(os.sched_getaffinity(0))])
    ours = Ours(driver)
    with tempfile.TemporaryDirectory() as folder:
        table(ours, driver, folder)
        if "--growth" in flags:
            growth(ours, folder)


if __name__ == "__main__":
    main(*sys.argv[1:])
