#!/usr/bin/env bash
# Packs the program with MuJoCo and the libraries it needs, and tests the archive where neither Rust
# nor these libraries can be read: `prebuilt.sh PROGRAM OUT`. It takes patchelf.
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
libraries=$(ldd "$program" | awk '$2 == "=>" { print $3 }' | grep -Ev '/lib(c|m|gcc_s|stdc\+\+)\.so')
[ -n "$libraries" ] || { echo "$program links no libraries" >&2; exit 1; }
for library in $libraries; do
  cp -L "$library" "$folder/lib"
  patchelf --set-rpath '$ORIGIN' "$folder/lib/$(basename "$library")"
done
patchelf --set-rpath '$ORIGIN/lib' "$folder/covers"
strip --strip-debug "$folder/covers"
packages=$(for library in $libraries; do dpkg-query --search "*/$(basename "$library")"; done |
  cut -d: -f1 | sort -u)
for package in $packages; do
  cp "/usr/share/doc/$package/copyright" "$folder/licences/$package"
done
tar -C "$work" --sort=name --owner=0 --group=0 --numeric-owner -czf "$out/$name.tar.gz" "$name"

# root of its own mounts, where the libraries and Rust cannot be read
mkdir "$work/clean"
tar -C "$work/clean" -xzf "$out/$name.tar.gz"
hidden=$(dpkg-query --listfiles $packages | grep '\.so\.' | xargs -n 1 realpath | sort -u)
export hidden here="$work/clean/$name"
unshare --mount --map-root-user bash -euo pipefail -c '
  for file in $hidden; do mount --bind /dev/null "$file"; done
  cd "$here"
  run() { env -i PATH=/usr/bin:/bin HOME="$here" ./covers "$@"; }
  run train --budget smoke --folder run > train.txt
  run eval pretrained --episodes 16 > eval.txt
  grep -q "drawer-close" eval.txt
  [ -s run/summary.json ] || { echo "the archived program did not train" >&2; exit 1; }
  echo "the archived program trains and plays without installed libraries"'
ls -l "$out/$name.tar.gz"
