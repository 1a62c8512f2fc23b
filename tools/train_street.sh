#!/usr/bin/env bash
# Train a retriever of streets: render ten districts, then train `lpn --config street` from ImageNet's weights.
#   tools/train_street.sh OUT [OPTION...]       OPTION: of `relocbench train lpn`, such as --set seed=1
# OUT gets districts/ and street/. A run that was killed goes on where it stopped. Half an hour on one core; needs the
# extra `pretrained`.
set -euo pipefail
out=$(realpath -m "${1:?usage: tools/train_street.sh OUT [OPTION...]}")
shift
cd "$(dirname "$0")/.."
export PATH="$PWD/${VENV:-.venv}/bin:$PATH"

districts=()
for seed in $(seq 51 60); do
  relocbench build-dataset synthetic --split train --seed "$seed" --cameras front --size 256x256 --steps 40 --speed 40 \
    --conditions Sunny,Overcast,Rain,Night,Snow,WetCloudySunset --correspondences 0 --pair-rule nearest \
    --out "$out/districts/$seed" -q > /dev/null
  districts+=(-d "$out/districts/$seed")
done
relocbench train lpn --config street --backbone-weights imagenet "${districts[@]}" --out "$out/street" --workers 0 \
  --set epochs.all=4 --set steps_per_epoch=80 --set validate_every=2 --set batch=16 --set size=192 \
  --set backbone_rate=1e-4 --set rate=1e-2 --set network.dropout=0.25 "$@"
