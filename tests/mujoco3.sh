#!/usr/bin/env bash
# Builds the program with MuJoCo 3.2 or later from its Python wheel, and runs the tests that hold
# for every release: `mujoco3.sh RELEASE FOLDER`. Makefile's `mujoco3` prepares what it takes.
set -euo pipefail
release=$1
folder=$2/$release
tools=$2/python/bin
mkdir -p "$folder"
if [ ! -e "$folder/mujoco/libmujoco.so.$release" ]; then
  "$tools/pip" download --quiet --no-deps --python-version 3.11 --only-binary=:all: \
    --dest "$folder" "mujoco==$release"
  "$tools/wheel" unpack --dest "$folder" "$folder"/mujoco-*.whl
  mv "$folder/mujoco-$release/mujoco" "$folder"
fi
export MUJOCO_DIR=$folder/mujoco LD_LIBRARY_PATH=$folder/mujoco
export CARGO_TARGET_DIR=$folder/build CARGO_INCREMENTAL=0
packages=(covers-mujoco covers-envs covers-inpainting covers-robots covers-render covers-model-check)
cargo test --locked --no-fail-fast "${packages[@]/#/-p=}"
cargo build --locked --bin covers
cargo build --locked -p covers-benches --example env_times
