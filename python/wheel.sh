#!/usr/bin/env bash
# Builds a wheel that contains MuJoCo and the libraries it needs, and tests it in an environment that
# has neither Rust nor these libraries: `wheel.sh OUT`. Makefile's `wheel` prepares what it takes.
set -euo pipefail
out=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$(dirname "$0")"
project=$(realpath ..)

maturin build --quiet --release --locked --strip --auditwheel skip --out "$work/linked"
auditwheel repair --plat "manylinux_2_35_$(uname -m)" --wheel-dir "$work/whole" "$work"/linked/*.whl

# the licences of the libraries inside, as Debian states them
wheel unpack --dest "$work" "$work"/whole/*.whl
cd "$work"/covers_envs-*/
inside=$(cd covers_envs.libs && printf '%s\n' *.so.*)
[ -n "$inside" ] || { echo "the wheel contains no libraries" >&2; exit 1; }
licences=$(echo ./*.dist-info)/licenses
mkdir -p "$licences"
cp "$project"/LICENSE-* "$licences"
owners() { for file in $inside; do dpkg-query --search "*/${file%%-*}.so.*"; done; }
packages=$(owners | cut -d: -f1 | sort -u)
for package in $packages; do
  cp "/usr/share/doc/$package/copyright" "$licences/$package"
done
mkdir -p "$out"
rm -f "$out"/covers_envs-*.whl
wheel pack --dest-dir "$out" .

python3 -m venv "$work/clean"
"$work/clean/bin/pip" install --quiet "$out"/covers_envs-*.whl
hidden=$(dpkg-query --listfiles $packages | grep '\.so\.' | xargs -n 1 realpath | sort -u)
export hidden clean="$work/clean"
# root of its own mounts, where the libraries and Rust cannot be read
unshare --mount --map-root-user bash -euo pipefail -c '
  for file in $hidden; do mount --bind /dev/null "$file"; done
  cd /
  exec env -i PATH=/usr/bin:/bin "$clean/bin/python" -c "
import covers_envs
env = covers_envs.make_vec(\"button-press\", 2, seed=0)
env.reset()
for _ in range(env.decisions):
    observation, _, _, _, infos = env.step(env.expert_actions())
assert observation[\"image\"].std() > 1, \"the images are empty\"
print(\"the wheel simulates and renders without installed libraries\")
"'
ls -l "$out"
