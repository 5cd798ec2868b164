"""Models the seconds of a training iteration against the number of MPI ranks.

mpirun -n 2 /usr/bin/python3 benches/studies/ranks.py RUN

RUN is the folder of a run of one process: times of its parts are means over `timings.csv`, and
sizes come from `experiment.json` and the newest checkpoint. The two processes measure the time of
`MPI_Allgatherv` between them. Needs Debian's python3-mpi4py.
"""

import csv
import json
import math
import struct
import sys
import time
from pathlib import Path

from mpi4py import MPI

CHUNK = 8  # decisions of a chunk
WAVE = 64  # chunks that are shared at a time
VECTOR = 10 * 4  # bytes of an observation's vector
SUMS = 7 * 8  # bytes of a chunk's losses
NETWORK = 2e-6, 1 / 12.5e9  # assumed: seconds of a message, and of a byte at 100 Gbit/s


def all_gather(world, size):
    """Returns the median seconds to gather `size` bytes in all."""
    own, out = bytearray(size // world.size), bytearray(size // world.size * world.size)
    seconds = []
    for _ in range(200 if size < 1e6 else 30):
        world.Barrier()
        start = time.perf_counter()
        world.Allgatherv(own, out)
        seconds.append(time.perf_counter() - start)
    return sorted(seconds)[len(seconds) // 2]


def num_params(run):
    newest = max((run / "checkpoints").glob("*.safetensors"))
    with open(newest, "rb") as file:
        (length,) = struct.unpack("<Q", file.read(8))
        return json.loads(file.read(length))["policy.0.params"]["shape"][0]


def model(part, sizes, link, ranks, scale):
    """Returns the seconds of an iteration with networks of `scale` times the parameters."""
    envs, chunks, image, params, steps, minibatches = sizes
    latency, byte = link
    share = lambda count: math.ceil(count / ranks) / count

    def gathers(calls, size):
        # each call also exchanges lengths
        messages = 2 * calls * math.ceil(math.log2(ranks))
        return messages * latency + size * (ranks - 1) / ranks * byte

    return (
        part["environments"] * share(envs)
        + steps * gathers(7, envs * (image + VECTOR + 7) + 8 * ranks)
        + scale * part["update"] * share(min(chunks, WAVE))
        + minibatches * gathers(2 * math.ceil(chunks / WAVE), chunks * (4 * scale * params + SUMS))
        + scale * part["inference"]
        + part["assignment"]
    )


def main():
    world = MPI.COMM_WORLD
    small, large = (all_gather(world, size) for size in (64, 16_000_000))
    if world.rank > 0:
        return
    run = Path(sys.argv[1])
    settings = json.load(open(run / "experiment.json"))
    learner, envs = settings["learner"]["covers"], settings["envs"]
    rows = list(csv.DictReader(open(run / "timings.csv")))
    # a handover collects more
    rows = [row for row in rows if int(row["decisions"]) == learner["rollout_steps"]]
    parts = "total", "environments", "inference", "assignment", "update"
    part = {name: sum(float(row[name]) for row in rows) / len(rows) for name in parts}
    camera = envs["camera"]
    channels = 9 if camera["beside"] == "first_and_close_up" else 6
    ppo, decisions, num_envs = learner["ppo"], learner["rollout_steps"], envs["num_envs"]
    image = camera["size"] ** 2 * channels
    minibatches = ppo["epochs"] * math.ceil(decisions / ppo["minibatch"])
    params = num_params(run)
    here = small, large / 16e6
    print(f"{len(rows)} iterations: " + ", ".join(f"{n} {s:.3f} s" for n, s in part.items()))
    print(f"{params} parameters, {image} bytes of an image, {minibatches} minibatches")
    exchanged = decisions * image, minibatches * ppo["minibatch"] // CHUNK * 4 * params
    print("MB an iteration: %.1f of images, %.1f of gradients" % tuple(n / 1e6 for n in exchanged))
    print(f"all-gather here: {small * 1e6:.1f} us, {large / 16e6 * 1e9:.2f} ns a byte")
    sizes = num_envs, ppo["minibatch"] // CHUNK, image, params, decisions // num_envs, minibatches
    # 1,024 of each: a hundred times the decisions of an iteration
    wide_envs, wide_chunks = 1024, 1024
    more = wide_envs / num_envs
    wide = wide_envs, wide_chunks, image, params, decisions // num_envs, math.ceil(
        ppo["epochs"] * decisions * more / (wide_chunks * CHUNK)
    )
    wide_part = {name: seconds * more for name, seconds in part.items()}
    print("| ranks | today, here | today | ten times | wide | wide, ten times |")
    print("|---|---|---|---|---|---|")
    for ranks in [1 << power for power in range(11)]:
        cells = [
            model(part, sizes, here, ranks, 1),
            model(part, sizes, NETWORK, ranks, 1),
            model(part, sizes, NETWORK, ranks, 10),
            model(wide_part, wide, NETWORK, ranks, 1),
            model(wide_part, wide, NETWORK, ranks, 10),
        ]
        print(f"| {ranks} | " + " | ".join(f"{seconds:.2f}" for seconds in cells) + " |")


main()
