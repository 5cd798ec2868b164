"""Times networks here, in PyTorch and in escnn, in turn, and prints one table: layers.py DRIVER [ROUNDS]."""

import sys
import time
from statistics import median

import torch
from driver import Driver
from escnn import gspaces
from escnn import nn as enn

SPECS = {  # image size, batch, regular fields, whether 3 x 3 convolutions are followed by pooling
    "reference": (64, 64, [8, 16, 32, 32], False),
    "narrow": (64, 64, [4, 8, 16, 16], False),
    "pooled": (128, 16, [8, 16, 32, 32, 32], True),
    "wide": (64, 16, [16, 32, 64, 64], False),
}
TASKS = {"training": 1, "inference": 2, "latency": 20}  # runs of a turn
WAKING = 0.05  # seconds that each way runs before it is timed
PATIENCE = 300  # seconds that torch.compile may take in all


class Ours(Driver):
    def runner(self, name):
        return lambda task, threads: self.ask(name, task, threads)[0]


def dense(fields, pooled):
    """The expanded network: four channels for every regular field."""
    layers, channels = [], 6
    for n in fields:
        window = (3, 1, 1) if pooled else (4, 2, 1)
        layers += [torch.nn.Conv2d(channels, 4 * n, *window), torch.nn.ReLU()]
        layers += [torch.nn.MaxPool2d(2)] * pooled
        channels = 4 * n
    return torch.nn.Sequential(*layers)


def steerable(fields, pooled):
    space = gspaces.flipRot2dOnR2(N=2)  # D2
    layers, of = [], enn.FieldType(space, 6 * [space.trivial_repr])
    for n in fields:
        to = enn.FieldType(space, n * [space.regular_repr])
        size, stride, padding = (3, 1, 1) if pooled else (4, 2, 1)
        layers.append(enn.R2Conv(of, to, size, stride=stride, padding=padding))
        layers.append(enn.ReLU(to, inplace=False))
        if pooled:
            layers.append(enn.PointwiseMaxPool(to, 2))
        of = to
    return enn.SequentialModule(*layers)


class Torch:
    """A network of PyTorch or escnn; `wrap` makes its input from a tensor."""

    def __init__(self, net, x, wrap=lambda x: x):
        self.net, self.wrap = net, wrap
        self.inputs = {"training": x, "inference": x, "latency": x[:1].clone(memory_format=torch.preserve_format)}

    def forward(self, x):
        y = self.net(self.wrap(x))
        return getattr(y, "tensor", y)

    def __call__(self, task, threads):
        torch.set_num_threads(threads)
        x = self.inputs[task]
        self.net.train(task == "training")  # escnn keeps its expanded kernels in evaluation mode
        start = time.perf_counter()
        if task == "training":
            self.net.zero_grad(set_to_none=False)
            y = self.forward(x)
            y.backward(y.detach())  # the gradient of half the squared output
        else:
            with torch.no_grad():
                y = self.forward(x)
        elapsed = time.perf_counter() - start
        assert torch.isfinite(y).all()
        return 1e3 * elapsed


def peers(name, patience):
    """The ways to run a network in PyTorch, then in escnn; those that do not run are left out."""
    size, batch, fields, pooled = SPECS[name]
    x = torch.randn(batch, 6, size, size)
    last = x.to(memory_format=torch.channels_last)
    plain = lambda: dense(fields, pooled)
    ways = {
        "torch, channels first": lambda: Torch(plain(), x),
        "torch, channels last": lambda: Torch(plain().to(memory_format=torch.channels_last), last),
        "torch.compile": lambda: Torch(torch.compile(plain()), x),
        "escnn": lambda: steerable_runner(fields, pooled, x),
    }
    for way, make in ways.items():
        if way == "torch.compile" and patience[0] <= 0:
            print(f"{name}: torch.compile left out, it had its {PATIENCE} s", file=sys.stderr)
            continue
        started = time.perf_counter()
        try:
            runner = make()
            for threads in [1, 2]:
                for task in TASKS:
                    runner(task, threads)
            yield way, runner
        except Exception as error:  # a compiler may be missing, or refuse this Python
            print(f"{name}: {way} does not run: {type(error).__name__}: {error}", file=sys.stderr)
        if way == "torch.compile":
            patience[0] -= time.perf_counter() - started


def steerable_runner(fields, pooled, x):
    net = steerable(fields, pooled)
    return Torch(net, x, lambda x: enn.GeometricTensor(x, net.in_type))


def initialisation(ours, name, rounds):
    _, _, fields, pooled = SPECS[name]
    times = {"ours": [], "torch": [], "escnn": []}
    for i in range(max(3, rounds // 4)):
        times["ours"].append(ours(task="init", threads=1))
        for way, make in [("torch", dense), ("escnn", steerable)]:
            if way == "escnn" and i > 0:
                continue  # it takes seconds
            start = time.perf_counter()
            make(fields, pooled)
            times[way].append(1e3 * (time.perf_counter() - start))
    return {way: median(values) for way, values in times.items()}


def wake(run, task, threads):
    """Fills caches, and lets the system spread threads over cores, on which those of the way before may still be waiting busily."""
    start = time.perf_counter()
    while time.perf_counter() - start < WAKING:
        run(task, threads)


def row(name, task, threads, times):
    torch_way, best = min(((w, t) for w, t in times.items() if w.startswith("torch")), key=lambda p: p[1])
    escnn = times.get("escnn", float("nan"))
    ours = times["ours"]
    ratios = f"{best / ours:9.2f} {escnn / ours:9.2f}"
    print(f"{name:<14} {task:<10} {threads:>2} {ours:10.3f} {best:10.3f} {escnn:10.3f} {ratios}  {torch_way}", flush=True)


def main():
    driver, rounds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20
    ours, patience = Ours(driver), [PATIENCE]
    print(f"medians of {rounds} turns, ms; torch {torch.__version__}")
    print("network        task       threads  ours      torch      escnn   torch/ours escnn/ours  best of torch")
    for name in SPECS:
        runners = {"ours": ours.runner(name), **dict(peers(name, patience))}
        for task, repeats in TASKS.items():
            times = {(way, threads): [] for way in runners for threads in [1, 2]}
            for _ in range(rounds):
                for threads in [1, 2]:
                    for way, run in runners.items():
                        wake(run, task, threads)
                        times[way, threads] += [run(task, threads) for _ in range(repeats)]
            for threads in [1, 2]:
                row(name, task, threads, {w: median(t) for (w, n), t in times.items() if n == threads})
        row(name, "init", 1, initialisation(runners["ours"], name, rounds))
        multiplications = ours.ask(name, "multiplications", 1)
        print(f"{name:<14} multiplications of one image: {multiplications[0] / 1e6:.2f} million, dense {multiplications[1] / 1e6:.2f}")


main()
