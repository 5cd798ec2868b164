#!/usr/bin/env bash
# Runs a small sweep on a Slurm of one machine, in a folder of its own, and stops all that it
# started: `make slurm`. Needs Debian's slurmctld, slurmd, slurm-client and munge, and root.
set -euo pipefail
covers=$(realpath "$1")
folder=$(mktemp -d)
cd "$folder"
mkdir state spool munge
chmod 755 "$folder"
dd if=/dev/urandom of=munge/key bs=1024 count=1 2> /dev/null
chmod 700 munge && chmod 400 munge/key
pids=()
stop() {
  code=$?
  # jobs outlive the daemons, so they go first
  scancel --quiet --user=root || true
  for ((i = 0; i < 120; i++)); do
    if ! squeue --noheader | grep -q .; then break; fi
    sleep 0.25
  done
  kill "${pids[@]}" || true
  wait || true
  rm -rf "$folder"
  exit "$code"
}
trap stop EXIT
cat > slurm.conf <<CONF
ClusterName=covers
SlurmctldHost=localhost
SlurmctldPort=6917
SlurmdPort=6918
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
MaxArraySize=3
KillWait=5
MessageTimeout=30
ReturnToService=2
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
MpiDefault=none
NodeName=localhost CPUs=2 RealMemory=3000
PartitionName=low Nodes=localhost Default=YES PriorityTier=1 GraceTime=30
PartitionName=high Nodes=localhost PriorityTier=2 PreemptMode=OFF
CONF
export SLURM_CONF=$folder/slurm.conf
munged --foreground --force --key-file=munge/key --socket=munge/socket \
  --pid-file=munge/pid --log-file=munge/log --seed-file=munge/seed 2> munged.log &
pids+=($!)
sleep 1
slurmctld -D 2> slurmctld.out &
pids+=($!)
slurmd -D -N localhost 2> slurmd.out &
pids+=($!)
# waits until the command succeeds
await() {
  for ((i = 0; i < 1200; i++)); do
    if "$@" > /dev/null 2>&1; then return; fi
    sleep 0.25
  done
  echo "waited in vain for: $*" >&2
  tail -n 20 slurmctld.log slurmd.log >&2
  squeue >&2
  tail -n 5 slurm-*.out slurm-*.failures >&2
  return 1
}
idle() { sinfo --noheader --format=%t | grep -qx idle; }
await idle

# Four runs in arrays of at most three, under a time limit that ends each of them before its end.
cat > plan.json <<JSON
{"methods": ["covers", "equi"], "seeds": [1000, 1001], "budget": "smoke", "set":
  ["envs.embodiment=hand", "schedule.cycles=${CYCLES:-40}", "checkpoints.every=1"]}
JSON
"$covers" sweep plan.json --runs runs --slurm --time 1 > job.sh
bash job.sh | tee submitted
test "$(wc -l < submitted)" = 2

has_checkpoint() { compgen -G 'runs/*/checkpoints/*.safetensors'; }
await has_checkpoint
# as the system does where memory is short
kill -KILL "$(pgrep -f "^$covers sweep $folder/plan.json" | head -n 1)"
has_failure() { grep -q 'exit code 137' slurm-*.failures; }
await has_failure
# A requeued job waits for two minutes. This shortens the wait to ten seconds and more, which a node
# takes to forget the job's last attempt.
shorten_waits() {
  local before= now
  while sleep 10; do
    now=$(squeue --noheader --states=PENDING --format='%i %r' | sed -n 's/ BeginTime//p' | sort)
    comm -12 <(echo "$before") <(echo "$now") | grep . | while read -r id; do
      scontrol update JobId="$id" StartTime=now
    done || true
    before=$now
  done
}
shorten_waits 2> /dev/null &
pids+=($!)
running() { squeue --noheader --states=RUNNING --format=%i | grep .; }
await running
scontrol requeue "$(running | head -n 1)"
await running
sbatch --quiet --partition=high --cpus-per-task=2 --output=high.out --wrap='echo ran'
has_preempted() { grep -qs ran high.out; }
await has_preempted
echo "a member was killed, one requeued, and others preempted"
finished() { test "$(compgen -G 'runs/*/summary.json' | wc -l)" = 4; }
await finished

"$covers" sweep plan.json --runs runs | tee done
test "$(grep -c ': done$' done)" = 4
# logs of earlier attempts are still there
stopped=$(cat slurm-*.out | grep -c 'stopped after')
continued=$(cat slurm-*.out | grep -c 'continues after')
echo "members stopped $stopped times and continued $continued times"
test "$stopped" -ge 5 && test "$continued" -ge 5
