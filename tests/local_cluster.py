"""Runs a small sweep on HyperQueue's local cluster and checks its runs: make hyperqueue."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hyperqueue.cluster import LocalCluster, WorkerConfig

PLAN = {
    "methods": ["covers", "equi"],
    "seeds": [1000, 1001],
    "budget": "smoke",
    "set": [
        "envs.embodiment=hand",
        "schedule.cycles=1",
        "checkpoints.every=1",
        'schedule.groups=[{"group": "goal-reach", "decisions": 960, "variants": ["identity"]}]',
    ],
}
SECONDS = 600


def processes(runs):
    """Returns the ids of the running workers of the sweep."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"sweep" in words and os.fsencode(runs) in words and b"--job" in words:
            if not words[0].endswith(b"bash"):
                found.append(int(folder.name))
    return found


def main():
    covers = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        plan, runs = Path(scratch, "plan.json"), Path(scratch, "runs")
        plan.write_text(json.dumps(PLAN))
        sweep = [covers, "sweep", plan, "--runs", runs]
        program = subprocess.check_output([*sweep, "--hq"], text=True)
        # workers of the local cluster do not know their memory
        program, count = re.subn(r'"mem": \d+', "", program)
        assert count == 1, program
        with LocalCluster(str(Path(scratch, "server")), WorkerConfig(cores=2)):
            environment = {**os.environ, "HQ_SERVER_DIR": str(Path(scratch, "server"))}
            subprocess.run([sys.executable, "-c", program], env=environment, check=True)
            killed, clock = False, time.monotonic()
            while len(list(runs.glob("*/summary.json"))) < 4:
                assert time.monotonic() - clock < SECONDS, "the runs do not end"
                # as the system does where memory is short
                if not killed and list(runs.glob("*/checkpoints/*.safetensors")):
                    os.kill(processes(runs)[0], signal.SIGKILL)
                    killed = True
                time.sleep(0.05)
        assert killed
        again = subprocess.run(sweep, check=True, capture_output=True, text=True).stdout
        finished = [line for line in again.splitlines() if not line.startswith("next: ")]
        assert [line.split(": ")[1] for line in finished] == ["done"] * 4, again
        print("4 runs are finished, one of them after its worker was killed")


main()
