#!/usr/bin/env bash
# Set up everything that relocbench needs: a virtual environment, pinned packages, the system libraries of Open3D.
set -euo pipefail
cd "$(dirname "$0")/.."

python="${PYTHON:-python3}"
venv="${VENV:-.venv}"

fail() {
  printf 'set-up: %s\n' "$1" >&2
  exit 1
}

# An installation in place of another checkout would be pointed to this one without a word.
for installed in "$venv"/lib/python*/site-packages/relocbench-*.dist-info/direct_url.json; do
  [ -f "$installed" ] || continue
  owner=$(sed -n 's|.*"url": *"file://\([^"]*\)".*|\1|p' "$installed")
  if [ -d "$owner" ] && [ ! "$owner" -ef . ]; then
    fail "the virtual environment '$venv' belongs to the checkout in '$owner'; set VENV to another folder"
  fi
done

command -v "$python" >/dev/null || fail "no '$python'; relocbench needs Python 3.11 to 3.13 (set PYTHON=/path/to/python)"
"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' ||
  fail "'$python' is $("$python" -V 2>&1); relocbench needs Python 3.11 to 3.13 (set PYTHON=/path/to/python)"

# What Open3D's library is linked against, and the Debian packages that have it.
missing=()
for need in libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1 libX11.so.6:libx11-6 libgomp.so.1:libgomp1; do
  ldconfig -p | grep -qF "${need%%:*}" || missing+=("${need##*:}")
done
if [ "${#missing[@]}" -gt 0 ]; then
  hint="Open3D needs system libraries: apt-get install ${missing[*]}"
  [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || fail "$hint"
  echo "set-up: installing ${missing[*]}, which Open3D needs"
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${missing[@]}" >/dev/null || fail "$hint"
fi

if [ ! -x "$venv/bin/python" ]; then
  "$python" -m venv "$venv" || fail "cannot make a virtual environment; on Debian: apt-get install python3-venv"
fi
sed -n '/^uv==/,/[^\\]$/p' tools/hashes.txt |
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r /dev/stdin
echo "set-up: installing pinned packages (torch is large; this may take minutes)"
export VIRTUAL_ENV="$PWD/$venv"
case "$venv" in /*) VIRTUAL_ENV="$venv" ;; esac
# Compiled once here: a method's process may not write beside the packages, and would compile what it imports each time.
"$venv/bin/uv" pip install --quiet --compile-bytecode --require-hashes -r tools/hashes.txt
"$venv/bin/uv" pip install --quiet --no-deps --no-build-isolation -e .
OMP_NUM_THREADS=1 "$venv/bin/python" tools/compile_kernels.py
touch "$venv/.ready"
