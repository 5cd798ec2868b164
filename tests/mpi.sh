#!/usr/bin/env bash
# Compares runs on one to four ranks of MPI with those of one process, byte by byte, and resumes
# runs whose rank was killed or told to stop: `make mpi`. Needs Debian's openmpi-bin.
set -euo pipefail
covers=$(realpath "$1")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
# threads of Mesa compete with ranks; MPI's own threads keep the program from setting it
export LP_NUM_THREADS=0
ranks() { mpirun --oversubscribe --allow-run-as-root -n "$@"; }
settings=(--budget smoke --seed 1000 --threads 1 --embodiment hand --set checkpoints.every=1
  --set schedule.cycles=3)
same() {
  for file in metrics.csv evaluation.csv units.csv recognition.csv experiment.json \
    contact_sheet.png "checkpoints/$(ls "$1/checkpoints" | tail -n 1)"; do
    cmp "$1/$file" "$2/$file"
  done
}
for method in covers covers-sac cnn; do
  "$covers" train --preset "$method" "${settings[@]}" --folder "$method" > /dev/null
  for n in 1 2 3 4; do
    ranks "$n" "$covers" train --preset "$method" "${settings[@]}" --folder "$method-$n" > "$n.out"
    same "$method" "$method-$n"
    test "$(grep -c '^files: ' "$n.out")" = 1
    echo "$method on $n ranks: the bytes of one process"
  done
done

# Starts three ranks and waits for a checkpoint of theirs.
begin() {
  ranks 3 "$covers" train --preset covers "${settings[@]}" --folder "$1" > "$1.out" 2>&1 &
  until compgen -G "$1/checkpoints/*.safetensors" > /dev/null; do sleep 0.1; done
}
# Sends signal $2 to rank $3 of the run in folder $1, and waits for mpirun, whose exit code is $code.
signal() {
  for process in $(pgrep -f "^$covers train .*--folder $1"); do
    if grep -qz "^OMPI_COMM_WORLD_RANK=$3$" "/proc/$process/environ"; then
      kill "-$2" "$process"
    fi
  done
  code=0
  wait "$!" || code=$?
}
begin killed
signal killed KILL 1
echo "a rank was killed: exit code $code"
test "$code" != 0 && grep -q 'signal 9' killed.out
begin stopped
signal stopped TERM 0
echo "a rank was told to stop: exit code $code"
test "$code" = 3 && grep -q 'stopped after' stopped.out
for run in killed stopped; do
  ranks 2 "$covers" resume "$run" --threads 1 > resumed.out
  head -n 1 resumed.out
  same covers "$run"
done
