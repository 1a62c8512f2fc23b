#!/usr/bin/env bash
# Build the image of Dockerfile and run the demo in it. Without a Docker daemon its steps are taken here instead (TORCH_BACKEND=cpu as in the image, else with CUDA): the
# packages go into an environment of its own outside of the repository, from the built wheel, and the demo runs there.
# Prints what was done, seconds and size. Exits with 1 if a step or the demo fails.
set -euo pipefail
cd "$(dirname "$0")/.."
root="$PWD"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
start="$(date +%s)"
if docker info >/dev/null 2>&1; then
  docker build --quiet -t relocbench "$root"
  echo "image built in $(($(date +%s) - start)) s, $(docker image inspect -f '{{.Size}}' relocbench) bytes"
  docker run --rm -v "$work:/work" relocbench demo --out demo --quiet
else
  echo "no Docker daemon: the steps of Dockerfile in an environment of its own"
  uv="$root/${VENV:-.venv}/bin/uv"
  missing=()
  for package in $(grep -oE 'no-install-recommends [^\\]*' Dockerfile | cut -d' ' -f2-); do
    dpkg -s "$package" >/dev/null 2>&1 || missing+=("$package")
  done
  [ "${#missing[@]}" -eq 0 ] || { echo "missing system packages: ${missing[*]}" >&2; exit 1; }
  "$uv" venv --quiet --no-python-downloads --python "${PYTHON:-python3}" "$work/env"
  "$uv" build --quiet --wheel -b tools/hashes.txt --out-dir "$work/dist" "$root"
  wheel="$(echo "$work"/dist/*.whl)"
  install() { "$uv" pip install --quiet --python "$work/env/bin/python" "$@"; }
  if [ -n "${TORCH_BACKEND:-}" ]; then
    grep -oE '^(torch|torchvision)==[^ ]+' tools/hashes.txt >"$work/torch.txt"
    UV_TORCH_BACKEND="$TORCH_BACKEND" install -r "$work/torch.txt"
  fi
  install -c tools/hashes.txt "relocbench[cluster] @ file://$wheel"
  echo "installed in $(($(date +%s) - start)) s, $(du -sm "$work/env" | cut -f1) MB, $("$work/env/bin/python" -V)"
  cd "$work"
  start="$(date +%s)"
  env -u PYTHONPATH "$work/env/bin/relocbench" demo --out demo --quiet
fi
echo "demo in $(($(date +%s) - start)) s"
test -s "$work/demo/leaderboard/leaderboard.md"
