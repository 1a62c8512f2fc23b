#!/usr/bin/env bash
# Build the wheel, install it with requirements-light.txt into a new environment outside the repository, and run there
# what a scoring server runs. Prints the time, the size and the result of each command; exits with 1 if one fails.
#
#   tools/light_install.sh [PYTHON...]      default: python3
set -euo pipefail
cd "$(dirname "$0")/.."
root="$PWD"
uv="$root/${VENV:-.venv}/bin/uv"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
"$uv" build --quiet --wheel -b tools/hashes.txt --out-dir "$work/dist" "$root"
failed=0
for python in "${@:-python3}"; do
  env="$work/$(basename "$python")"
  start=$(date +%s.%N)
  "$uv" venv --quiet --no-python-downloads --python "$python" "$env"
  "$uv" pip install --quiet --python "$env/bin/python" -c "$root/tools/hashes.txt" -r "$root/requirements-light.txt"
  "$uv" pip install --quiet --python "$env/bin/python" --no-deps "$work"/dist/*.whl
  spent=$(echo "$(date +%s.%N) - $start" | bc)
  echo "$("$env/bin/python" -V): installed in $spent s, $(du -sm "$env" | cut -f1) MB"
  mkdir -p "$work/run-$(basename "$python")"
  cd "$work/run-$(basename "$python")"
  PYTHONPATH="$root:$root/tests/support" "$root/${VENV:-.venv}/bin/python" -c \
    'from pathlib import Path; from small_dataset import make_small_dataset; make_small_dataset(Path("data"))'
  try() {
    if "$env/bin/$1" "${@:2}" >out 2>err; then echo "  ok      $*"; else echo "  FAILED  $*: $(tail -n 1 err)"; failed=1; fi
  }
  try relocbench --version
  try relocbench validate data
  try relocbench inspect data
  try relocbench evaluate -d data -m identity -o results
  try relocbench evaluate -d data -m theirs --predictions results/*/identity -o scored
  try relocbench leaderboard scored --out board
  try python -c 'import relocbench as rb; assert len(rb.read_leaderboard("scored")) and len(rb.read_errors("scored"))'
  if "$env/bin/relocbench" evaluate -d data -m dso -o results >out 2>err || ! grep -q "numba" err; then
    echo "  FAILED  dso does not name the missing numba: $(tail -n 1 err)"; failed=1
  else
    echo "  ok      dso names the missing package: $(tail -n 1 err)"
  fi
done
exit "$failed"
