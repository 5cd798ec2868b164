#!/usr/bin/env bash
# Packs the program with MuJoCo and the libraries it needs, and tests the archive where these
# libraries, this checkout and cargo's folders cannot be read: `prebuilt.sh PROGRAM OUT`. It takes
# patchelf.
set -euo pipefail
program=$(realpath "$1")
out=$2
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

version=$("$program" --version | cut -d' ' -f2)
name=covers-$version-$(uname -m)-linux
folder=$work/$name
mkdir -p "$folder"/{lib,licences} "$out"
cp "$program" "$folder/covers"
cp -r assets/pretrained LICENSE-* "$folder"
# all libraries but those of glibc and gcc: the drivers of OpenGL need the system's own, newer ones
libraries=$(ldd "$program" | awk '$2 == "=>" { print $3 }' |
  grep -Ev '/lib(c|m|dl|rt|pthread|util|resolv|gcc_s|stdc\+\+)\.so')
[ -n "$libraries" ] || { echo "$program links no libraries" >&2; exit 1; }
for library in $libraries; do
  cp -L "$library" "$folder/lib"
  patchelf --set-rpath '$ORIGIN' "$folder/lib/$(basename "$library")"
done
patchelf --set-rpath '$ORIGIN/lib' "$folder/covers"
strip --strip-debug "$folder/covers"
for library in $libraries; do
  # a library that no package owns ends the script, as its licence is unknown
  owner=$(dpkg-query --search "$(realpath "$library")" | cut -d: -f1)
  cp "/usr/share/doc/$owner/copyright" "$folder/licences/$owner"
done
tar -C "$work" --sort=name --owner=0 --group=0 --numeric-owner -czf "$out/$name.tar.gz" "$name"

# root of its own mounts, where the libraries and what builds the program cannot be read
mkdir "$work/clean"
tar -C "$work/clean" -xzf "$out/$name.tar.gz"
hidden=$(realpath $libraries)
export hidden here="$work/clean/$name" checkout="$PWD" cargo="${CARGO_HOME:-$HOME/.cargo}"
unshare --mount --map-root-user bash -euo pipefail -c '
  for file in $hidden; do mount --bind /dev/null "$file"; done
  cd "$here"
  for place in "$checkout" "$cargo"; do [ ! -d "$place" ] || mount -t tmpfs none "$place"; done
  run() { env -i PATH=/usr/bin:/bin HOME="$here" ./covers "$@"; }
  run train --budget smoke --folder run > train.txt
  run eval pretrained --episodes 16 --json | tail -n 1 > eval.json
  # each of sixteen variants is an object with its share of successes
  solved=$(grep -oE "\"success\":(1\.0|0\.[5-9][0-9]*)" eval.json | wc -l)
  [ "$solved" = 16 ] || { echo "the archived policies solve $solved of 16 variants" >&2; exit 1; }
  [ -s run/summary.json ] || { echo "the archived program did not train" >&2; exit 1; }
  echo "the archived program trains and plays without installed libraries"'
ls -l "$out/$name.tar.gz"
