"""Times training steps on a GPU here and in PyTorch, in turn, and prints one table: gpu.py DRIVER [ROUNDS] [ADAPTER].

The network is the reference network of layers.py, here and, expanded, in PyTorch; a step is a forward and a backward pass over a
batch that lies on the device. Steps are started without waiting for one another, and the wait for the last is counted. PyTorch runs
on CUDA where there is a device for it, and otherwise on the processor, which compares nothing, but shows that the script works.
"""

import re
import subprocess
import sys
import time
from statistics import median

import torch

FIELDS, SIZE = [8, 16, 32, 32], 64
BATCHES = [64, 512, 4096]
SECONDS = 1.0  # of a measurement, at least
CUDA = torch.cuda.is_available()
DEVICE = torch.device("cuda" if CUDA else "cpu")


def ours(driver, adapter):
    """The adapter's name and the milliseconds of a step by batch; batches that do not fit it are left out."""
    text = subprocess.run([driver, *adapter], capture_output=True, text=True, check=True).stdout
    name, table = text.split("\n\n")[1].split("\n", 1)
    rows = re.findall(r"^ *(\d+) +\d+ +([\d.]+)$", table, re.MULTILINE)
    return name, {int(batch): float(ms) for batch, ms in rows}


def dense():
    """The expanded network: four channels for every regular field."""
    layers, channels = [], 6
    for fields in FIELDS:
        layers += [torch.nn.Conv2d(channels, 4 * fields, 4, 2, 1), torch.nn.ReLU()]
        channels = 4 * fields
    return torch.nn.Sequential(*layers).to(DEVICE)


def multiplications(batch):
    """Of a step of the expanded network: three products a layer, but for the gradient in the pictures."""
    total, side, channels = 0, SIZE, 6
    for number, fields in enumerate(FIELDS):
        side //= 2
        product = side**2 * 16 * channels * 4 * fields
        total += product * (2 if number == 0 else 3)
        channels = 4 * fields
    return batch * total


def synchronise():
    if CUDA:
        torch.cuda.synchronize()


def ms_a_run(run):
    """Milliseconds of a run, over as many runs as take so many seconds."""
    runs = 1
    while True:
        synchronise()
        start = time.perf_counter()
        for _ in range(runs):
            run()
        synchronise()
        elapsed = time.perf_counter() - start
        if elapsed >= SECONDS:
            return 1e3 * elapsed / runs
        runs *= 2


def step(net, batch, layout):
    """A training step over a batch that is already there."""
    x = torch.rand(batch, 6, SIZE, SIZE, device=DEVICE).to(memory_format=layout)
    gradient = torch.ones_like(net(x))

    def run():
        net.zero_grad(set_to_none=False)
        net(x).backward(gradient)

    for _ in range(3):
        run()
    return run


def graph(batch, layout):
    """The same, recorded as a CUDA graph."""
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        run = step(dense().to(memory_format=layout), batch, layout)
    torch.cuda.current_stream().wait_stream(side)
    recorded = torch.cuda.CUDAGraph()
    with torch.cuda.graph(recorded):
        run()
    return recorded.replay


def peers(batch):
    """What runs a step in PyTorch, by name; each with TF32 off and on."""
    first, last = torch.contiguous_format, torch.channels_last
    ways = {
        "eager, channels first": lambda: step(dense(), batch, first),
        "eager, channels last": lambda: step(dense().to(memory_format=last), batch, last),
        "compiled": lambda: step(torch.compile(dense()), batch, first),
    }
    if CUDA:
        ways |= {"graph, channels first": lambda: graph(batch, first), "graph, channels last": lambda: graph(batch, last)}
    return ways


def set_tf32(on):
    torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = on


def measured(batch, rounds, ask):
    """Medians in ms by way; `ask` is a turn of ours."""
    times, runs = {"ours": []}, {}
    for tf32 in (False, True) if CUDA else (False,):
        for way, make in peers(batch).items():
            name = f"{way}, TF32" if tf32 else way
            set_tf32(tf32)
            try:
                runs[name], times[name] = (tf32, make()), []
            except Exception as error:  # no compiler, or no room
                print(f"batch {batch}: {name} does not run: {type(error).__name__}: {error}".split("\n")[0], file=sys.stderr)
    for _ in range(rounds):
        own = ask().get(batch)
        if own:
            times["ours"].append(own)
        for name, (tf32, run) in runs.items():
            set_tf32(tf32)
            times[name].append(ms_a_run(run))
    return {way: median(values) for way, values in times.items() if values}


def peak():
    """Multiplications a second of one large product, the adapter's own measure of what it can; TF32 off."""
    set_tf32(False)
    side = 8192 if CUDA else 1024
    a, b = (torch.rand(side, side, device=DEVICE) for _ in range(2))
    return side**3 / (1e-3 * ms_a_run(lambda: a @ b))


def main():
    driver, rounds, adapter = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3, sys.argv[3:]
    name, _ = ours(driver, adapter)
    where = torch.cuda.get_device_name() if CUDA else "the processor: there is no CUDA device"
    limit = peak()
    print(f"ours on {name}; torch {torch.__version__} on {where}; medians of {rounds} rounds")
    print(f"one large product in PyTorch: {2e-12 * limit:.2f} TFLOP/s")
    print("batch  way                            ms a step  torch/ours  dense TFLOP/s  share of the product")
    for batch in BATCHES if CUDA else BATCHES[:1]:
        times = measured(batch, rounds, lambda: ours(driver, adapter)[1])
        for way, ms in times.items():
            rate = multiplications(batch) / (1e-3 * ms)
            ratio = ms / times["ours"] if "ours" in times else float("nan")
            print(f"{batch:5}  {way:<30} {ms:9.3f} {ratio:11.2f} {2e-12 * rate:14.3f} {rate / limit:21.2f}", flush=True)


main()
