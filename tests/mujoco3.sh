#!/usr/bin/env bash
# Builds the program with MuJoCo 3.2 or later from its Python wheel, and runs all tests:
# `mujoco3.sh RELEASE FOLDER`. Makefile's `mujoco3` prepares what it takes.
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
# one folder for all releases: most packages do not depend on MuJoCo
export CARGO_TARGET_DIR=$2/build CARGO_INCREMENTAL=0
cargo test --workspace --locked --no-fail-fast
cargo build --locked --bin covers
cargo build --locked -p covers-benches --example env_times
mkdir -p "$folder/build/examples"
cp "$CARGO_TARGET_DIR/debug/covers" "$folder/build"
cp "$CARGO_TARGET_DIR/debug/examples/env_times" "$folder/build/examples"
