#!/usr/bin/env bash
# Make the results in leaderboard/retrieval/ again: sets and trainings in a scratch folder, tables in the repository.
#   tools/publish_retrieval.sh SCRATCH [SAMPLE]
# SAMPLE holds sample_drone.jpg and sample_satellite.jpg. Hours on two cores; run again, it does what is missing.
set -euo pipefail
mkdir -p "${1:?usage: tools/publish_retrieval.sh SCRATCH [SAMPLE]}"
scratch=$(realpath "$1")
sample=${2:+$(realpath "$2")}
cd "$(dirname "$0")/.."
export PATH="$PWD/${VENV:-.venv}/bin:$PATH"

relocbench build-dataset cross-view --split train --places 240 --drone-views 12 --size 128 \
  --conditions Sunny,Sunny,Overcast,Rain,Snow --out "$scratch/train" -q
relocbench build-dataset cross-view --split test --places 90 --distractors 30 --drone-views 6 --size 128 \
  --conditions Sunny,Overcast,Rain,Snow --out "$scratch/test" -q

# No ImageNet weights: one long training, of none of the systems compared, gives all of them their backbone.
relocbench train lpn --dataset "$scratch/train" --config global-average --set network.backbone=resnet18 \
  --set mixed_precision=true --set size=96 --set batch=16 --set rate=1e-2 --set backbone_rate=1e-2 --set warm_up=100 \
  --set network.dropout=0.2 --set epochs.all=330 --set steps_per_epoch=15 --set validate_every=40 --out "$scratch/backbone"

python benchmarks/lpn_configurations.py --train "$scratch/train" --test "$scratch/test" --scratch "$scratch/systems" \
  --backbone-weights "$scratch/backbone/weights.safetensors" --out leaderboard/retrieval \
  --set network.backbone=resnet18 --set mixed_precision=true --set size=128 --set backbone_rate=1e-3 --set rate=3e-3 \
  --set network.dropout=0.25 --set epochs.all=8 --set epochs.classifier=2 --set epochs.refined=4 --set epochs.heatmap=4 \
  --jobs 2 --workers 0

if [ -n "$sample" ]; then
  board=$PWD/leaderboard/retrieval/real
  cd "$scratch" # pages name weights by their paths from here
  asked=(-m random -m colour-histogram -m orb-bow -m lpn-seed0=lpn)
  asked+=(--set lpn-seed0.weights=systems/lpn-seed0/weights.safetensors)
  relocbench evaluate --task retrieval -d "$sample" --out real -q "${asked[@]}"
  relocbench leaderboard real --out "$board" -q
fi
