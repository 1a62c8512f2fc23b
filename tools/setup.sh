#!/usr/bin/env bash
# Set up what relocbench needs: a virtual environment, pinned packages, and one system library.
set -euo pipefail
cd "$(dirname "$0")/.."

python="${PYTHON:-python3}"
venv="${VENV:-.venv}"
uv_version=0.13.8

fail() {
  printf 'set-up: %s\n' "$1" >&2
  exit 1
}

command -v "$python" >/dev/null || fail "no '$python'; relocbench needs Python >= 3.11 (set PYTHON=/path/to/python)"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "'$python' is $("$python" -V 2>&1); relocbench needs Python >= 3.11 (set PYTHON=/path/to/python)"

if ! ldconfig -p 2>/dev/null | grep -q 'libusb-1\.0\.so'; then
  hint="Open3D needs the system library libusb-1.0: apt-get install libusb-1.0-0"
  [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || fail "$hint"
  echo "set-up: installing libusb-1.0-0, which Open3D needs"
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq libusb-1.0-0 >/dev/null || fail "$hint"
fi

if [ ! -x "$venv/bin/python" ]; then
  "$python" -m venv "$venv" || fail "cannot make a virtual environment; on Debian: apt-get install python3-venv"
fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check "uv==$uv_version"
echo "set-up: installing pinned packages (torch is large; this may take minutes)"
export VIRTUAL_ENV="$PWD/$venv"
case "$venv" in /*) VIRTUAL_ENV="$venv" ;; esac
"$venv/bin/uv" pip install --quiet --require-hashes -r constraints.txt
"$venv/bin/uv" pip install --quiet --no-deps --no-build-isolation -e .
touch "$venv/.ready"
