#!/usr/bin/env bash
# Run a command while N endless loops keep the processors busy.
#   tools/beside_busy_loops.sh N COMMAND...
set -u
count="$1"
shift
loops=()
trap 'kill "${loops[@]}" 2>/dev/null' EXIT
for ((i = 0; i < count; i++)); do
  (while :; do :; done) &
  loops+=("$!")
done
env "$@"
