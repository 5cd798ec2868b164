"""Measures everything on a GPU in one command: gpu.py BUNDLE OUT [--limit SECONDS] [--rounds N] [--adapter NAME] [--dry-run].

BUNDLE is a folder that gpu.sh made on any x86-64 machine; nothing else is needed but Python, and PyTorch for the peers' figures. OUT
gets results.json, which is written anew after every measurement so that an interrupted run keeps its figures, table.md, and the logs.
Sections run in the order below, most important first, until the limit; what was left out is listed.

The peers are the same networks, expanded, in PyTorch: eager, compiled and recorded as a CUDA graph, with TF32 off and on. A training
step is a forward and a backward pass over a batch that lies on the device; steps are started without waiting for one another, and
the wait for the last is counted. --dry-run takes tiny sizes and any device, to see that the script works.
"""

import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import time
from statistics import median

try:
    import torch
except ImportError:
    torch = None

# name: side of the picture, fields, pooled
NETWORKS = {
    "reference": (64, [8, 16, 32, 32], False),
    "narrow": (64, [4, 8, 16, 16], False),
    "pooled": (128, [8, 16, 32, 32, 32], True),
    "wide": (64, [16, 32, 64, 64], False),
}
TASKS = ["training", "decisions"]
# of a measurement in PyTorch, at least
SECONDS = 0.15
TESTS = [("equivariant", []), ("rl", []), ("covers-rs", ["device::"])]
# of all tests, at most: a driver in software needs minutes
TEST_SECONDS = 150
FRAMES = [("hand", "button-press"), ("sawyer", "button-press")]
LEARN = [
    "envs.camera.oversampling=1",
    'envs.camera.beside="first"',
    "schedule.cycles=1",
    "schedule.clock=turns",
    "evaluation.visit_rounds=2",
    "evaluation.rounds=2",
    "evaluation.every=2",
    'schedule.groups=[{"group":"goal-reach","variants":["identity","flip x","flip y","half turn"],"decisions":DECISIONS}]',
]


class Deadline(Exception):
    """The limit is reached."""


class Session:
    """Figures so far, and the time that is left."""

    def __init__(self, arguments):
        self.bundle = arguments.bundle.resolve()
        self.out = arguments.out
        self.rounds, self.dry, self.adapter = arguments.rounds, arguments.dry_run, arguments.adapter
        self.end = time.monotonic() + arguments.limit
        self.batches = [2] if self.dry else [64, 512, 4096]
        self.networks = ["narrow"] if self.dry else list(NETWORKS)
        libraries = [str(self.bundle / "lib"), os.environ.get("LD_LIBRARY_PATH", "")]
        self.environment = os.environ | {"LD_LIBRARY_PATH": ":".join(filter(None, libraries)), "RUST_BACKTRACE": "1"}
        self.figures = {"finished": [], "left out": []}
        self.failed = False
        self.out.mkdir(parents=True, exist_ok=True)

    def left(self):
        left = self.end - time.monotonic()
        if left <= 0:
            raise Deadline("out of time")
        return left

    def put(self, section, key, value):
        self.left()
        self.figures.setdefault(section, {})[key] = value
        self.save()
        print(f"{section}: {key}: {value}", flush=True)

    def save(self):
        partial = self.out / "results.json.partial"
        partial.write_text(json.dumps(self.figures, indent=1) + "\n")
        partial.replace(self.out / "results.json")

    def run(self, name, *command, limit=3600):
        """Exit status, output and seconds of a command of the bundle; its log is kept."""
        log = self.out / f"{name}.log"
        with log.open("w") as file:
            started = time.monotonic()
            try:
                done = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, env=self.environment, timeout=min(limit, self.left()))
            except subprocess.TimeoutExpired:
                raise Deadline(f"{name} took longer than it had") from None
        self.failed |= done.returncode != 0
        return done.returncode, log.read_text(errors="replace"), time.monotonic() - started


class Driver:
    """A program that answers lines with lines."""

    def __init__(self, session, name, *arguments):
        pipe = subprocess.PIPE
        errors = (session.out / f"{name}.errors").open("w")
        command = [session.bundle / "bin" / name, *arguments]
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=errors, text=True, env=session.environment)

    def ask(self, *words):
        print(*words, file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline().strip()
        if not answer:
            raise RuntimeError(f"the driver ended at `{' '.join(map(str, words))}`")
        if answer.startswith("error "):
            raise RuntimeError(answer.removeprefix("error "))
        return answer


def machine(session):
    """Adapters and versions."""
    session.put("machine", "adapter", driver(session).ask("adapter"))
    if torch and torch.cuda.is_available():
        session.put("machine", "cuda", torch.cuda.get_device_name())
    session.put("machine", "torch", torch.__version__ if torch else "none")
    session.put("machine", "processors", os.cpu_count())
    code, text, _ = session.run("doctor", session.bundle / "bin/covers", "doctor")
    session.put("machine", "doctor", f"exit {code}: see doctor.log, {len(text.splitlines())} lines")


def driver(session):
    if not hasattr(session, "driver"):
        session.driver = Driver(session, "gpu_times", *filter(None, [session.adapter]))
    return session.driver


def tests(session):
    """The GPU tests of three packages."""
    left = 3600 if session.dry else TEST_SECONDS
    for package, words in TESTS:
        code, text, seconds = session.run(f"tests-{package}", session.bundle / "tests" / package, *words, limit=left)
        left -= seconds
        result = re.findall(r"test result: (.*?); finished", text)
        session.put("tests", package, f"exit {code}: {result[-1] if result else 'no result'}; {seconds:.0f} s")


def kernels(session):
    """Kernel times of the reference network by name."""
    for network, batch in [(name, batch) for batch in session.batches[:2] for name in session.networks[:1]]:
        words = driver(session).ask(network, "kernels", batch).split()
        times = list(zip(words[::2], map(float, words[1::2])))
        session.put("kernels", f"{network}, batch {batch}", times)


def updates(session):
    """PPO updates and decisions, on the GPU and on two and all cores."""
    cores = sorted({2, os.cpu_count() or 2})
    places = ["gpu", *cores]
    for width in [1] if session.dry else [1, 4]:
        for place in places[:2] if session.dry or width > 1 else places:
            session.put("updates", f"width {width}, {place}", measured(session, lambda: driver(session).ask("update", width, place)))
    for batch in [10] if session.dry else [10, 64, 512, 4096]:
        for place in places[:2]:
            session.put("decide", f"batch {batch}, {place}", measured(session, lambda: driver(session).ask("decide", batch, place)))


def measured(session, ask):
    """The median in ms, or what went wrong."""
    try:
        return median(float(ask()) for _ in range(session.rounds))
    except RuntimeError as error:
        session.failed = True
        return str(error)


def tables(session):
    """Every network, task and batch, here and in PyTorch."""
    for network in session.networks:
        for batch in session.batches:
            for task in TASKS:
                session.left()
                cell(session, network, batch, task)


def cell(session, network, batch, task):
    key = f"{network}, {task}, batch {batch}"
    figures = {"ours": measured(session, lambda: driver(session).ask(network, task, batch))}
    for way, tf32, make in peers(session, network, batch, task):
        name = f"{way}, TF32" if tf32 else way
        try:
            set_tf32(tf32)
            run = make()
            figures[name] = median(ms_a_run(run) for _ in range(session.rounds))
        except Exception as error:  # no compiler, or no room
            figures[name] = f"{type(error).__name__}: {error}".split("\n")[0][:200]
        finally:
            run = None
            if cuda():
                torch.cuda.empty_cache()
    session.put("table", key, figures)


def cuda():
    return torch is not None and torch.cuda.is_available()


def peers(session, network, batch, task):
    """The ways to run a network in PyTorch, each with TF32 off and on."""
    if torch is None:
        return
    first, last = torch.contiguous_format, torch.channels_last
    for tf32 in (False, True) if cuda() else (False,):
        yield "eager, channels first", tf32, lambda: runner(network, batch, task, first)
        yield "eager, channels last", tf32, lambda: runner(network, batch, task, last)
        if cuda():
            yield "graph, channels first", tf32, lambda: graph(network, batch, task, first)
            yield "graph, channels last", tf32, lambda: graph(network, batch, task, last)
        if network == session.networks[0] and task == "training" and not session.dry:
            yield "compiled", tf32, lambda: runner(network, batch, task, first, torch.compile)


def dense(network):
    """The expanded network: four channels for every regular field."""
    _, fields, pooled = NETWORKS[network]
    layers, channels = [], 6
    for n in fields:
        window = (3, 1, 1) if pooled else (4, 2, 1)
        layers += [torch.nn.Conv2d(channels, 4 * n, *window), torch.nn.ReLU()]
        layers += [torch.nn.MaxPool2d(2)] * pooled
        channels = 4 * n
    return torch.nn.Sequential(*layers).to("cuda" if cuda() else "cpu")


def runner(network, batch, task, layout, change=lambda net: net):
    """A pass over a batch that is already there."""
    net = change(dense(network).to(memory_format=layout))
    side = NETWORKS[network][0]
    x = torch.rand(batch, 6, side, side, device="cuda" if cuda() else "cpu").to(memory_format=layout)
    gradient = torch.ones_like(net(x))

    def train():
        net.zero_grad(set_to_none=False)
        net(x).backward(gradient)

    def decide():
        with torch.no_grad():
            net(x)

    run = train if task == "training" else decide
    for _ in range(3):
        run()
    return run


def graph(network, batch, task, layout):
    """A pass that was recorded as a CUDA graph."""
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        run = runner(network, batch, task, layout)
    torch.cuda.current_stream().wait_stream(side)
    recorded = torch.cuda.CUDAGraph()
    with torch.cuda.graph(recorded):
        run()
    return recorded.replay


def set_tf32(on):
    torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = on


def synchronise():
    if cuda():
        torch.cuda.synchronize()


def ms_a_run(run):
    """Milliseconds of a run, over as many runs as take long enough."""
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
        runs = 2 * runs if elapsed <= 0 else max(2 * runs, int(1.2 * runs * SECONDS / elapsed))


def frames(session):
    """Milliseconds of a picture and pictures a second with every renderer that there is."""
    for renderer in ["egl", "osmesa"]:
        session.environment["COVERS_GL"] = renderer
        try:
            times = Driver(session, "env_times")
            for embodiment, group in FRAMES:
                for measure, threads in [("frame", 1), ("image", 1), ("image", min(4, os.cpu_count() or 1))]:
                    session.put("frames", f"{renderer}, {embodiment}, {group}, {measure}, threads {threads}", float(times.ask(measure, embodiment, group, threads)))
        except (RuntimeError, ValueError, OSError) as error:
            session.put("frames", renderer, str(error))
    session.environment.pop("COVERS_GL")


def learn(session):
    """Goal Reach from nothing, on the GPU and on the processor."""
    for device in ["gpu", "cpu"]:
        folder = session.out / f"learn-{device}"
        decisions = "1000" if session.dry else "10000"
        sets = [word for setting in LEARN for word in ("--set", setting.replace("DECISIONS", decisions))]
        command = ["train", "--preset", "equi", "--budget", "full", "--seed", "1000", "--device", device, "--folder", folder, *sets]
        code, _, seconds = session.run(f"learn-{device}", session.bundle / "bin/covers", *command)
        summary = folder / "summary.json"
        groups = json.loads(summary.read_text())["groups"] if summary.exists() else []
        session.put("learn", device, {"exit": code, "seconds": round(seconds, 1), "groups": groups})


SECTIONS = [machine, tests, kernels, tables, updates, learn, frames]


def table(figures):
    """The table of networks in Markdown, in ms, with the ratio of the fastest peer without TF32."""
    lines = ["| network, task, batch | ours, ms | fastest peer, ms | way | peer/ours |", "|---|---|---|---|---|"]
    for key, ways in figures.get("table", {}).items():
        times = {way: ms for way, ms in ways.items() if isinstance(ms, float) and way != "ours" and "TF32" not in way}
        ours = ways["ours"]
        if not isinstance(ours, float) or not times:
            lines.append(f"| {key} | {ours} | | | |")
            continue
        way = min(times, key=times.get)
        lines.append(f"| {key} | {ours:.3f} | {times[way]:.3f} | {way} | {times[way] / ours:.2f} |")
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("bundle", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--limit", type=float, default=540.0, help="seconds, at most")
    parser.add_argument("--rounds", type=int, default=3, help="measurements of each figure, of which the median is kept")
    parser.add_argument("--adapter", help="a part of the adapter's name")
    parser.add_argument("--only", nargs="*", choices=[s.__name__ for s in SECTIONS], help="these sections alone")
    parser.add_argument("--dry-run", action="store_true")
    session = Session(parser.parse_args())
    only = parser.parse_args().only
    for section in SECTIONS:
        name = section.__name__
        if only and name not in only:
            continue
        started = time.monotonic()
        try:
            session.left()
            section(session)
            session.figures["finished"].append(f"{name}: {time.monotonic() - started:.0f} s")
        except Deadline as reason:
            session.figures["left out"].append(f"{name}: {reason}")
        except Exception as error:  # the other sections go on
            session.failed = True
            session.figures["left out"].append(f"{name}: {type(error).__name__}: {error}")
        session.save()
    (session.out / "table.md").write_text(table(session.figures))
    print(table(session.figures))
    print("finished:", session.figures["finished"], "left out:", session.figures["left out"], sep="\n")
    sys.exit(session.failed)


main()
