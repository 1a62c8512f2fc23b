#!/usr/bin/env bash
# Train the weights of gn-net and gn-net-contrastive from nothing but EfficientNet-Lite0's ImageNet weights:
# render seventeen districts, two at a time, make pairs of photographs, then train both networks side by side.
#   tools/train_gn_net.sh OUT PHOTOGRAPHS [OPTION...]       OPTION: of `relocbench train gn-net`, such as --set seed=1
# PHOTOGRAPHS holds ie_tower/ (480 frames of walks through a building, 1280x720, every second one of the repository
# JSebastianIEU/ie-tower-visual-place-recognition, commit ea8bdfab, MIT) and landscapes/ (the five by Aitzol
# Berasategi in Debian's package lomiri-wallpapers-16.04, CC-BY-4.0; docs/training.md has the commands).
# OUT gets districts/, photographs/, gn-net/ and gn-net-contrastive/. A run that was killed goes on where it stopped.
# Less than three hours on two cores; needs the extra `pretrained`.
set -euo pipefail
usage="usage: tools/train_gn_net.sh OUT PHOTOGRAPHS [OPTION...]"
out=$(realpath -m "${1:?$usage}")
pictures=$(realpath "${2:?$usage}")
shift 2
cd "$(dirname "$0")/.."
export PATH="$PWD/${VENV:-.venv}/bin:$PATH"
mkdir -p "$out/districts" "$out/photographs"

district() { # SEED OPTION...: one drive a condition, seen by six cameras
  seed=$1
  shift
  relocbench build-dataset synthetic --split train --seed "$seed" --cameras six --size 512x512 --reference all \
    --correspondences 1500 --out "$out/districts/$seed" -j 1 -q "$@"
}
render() { # SEED: near and far keyframes, in all conditions or in half of them
  all=Sunny,Rain,Night,Fog,WetNoon,Neutral,Overcast,Snow,SoftRainNoon,WetCloudySunset
  case $1 in
    22 | 25) district "$1" --conditions Sunny,Rain,Night,Fog,WetNoon --steps 6 --speed 14 ;;
    23 | 26) district "$1" --conditions Neutral,Overcast,Snow,SoftRainNoon,WetCloudySunset --steps 6 --speed 14 ;;
    24) district "$1" --conditions Sunny,Night,Snow,WetCloudySunset,Overcast --steps 6 --speed 14 ;;
    21 | 27 | 28 | 29 | 30 | 31) district "$1" --conditions $all --steps 5 --speed 14 ;;
    *) district "$1" --conditions $all --steps 4 --speed 30 --distance 3 ;;
  esac
  echo "rendered district $1"
}
photographs() { # NAME FOLDER OPTION...: each seen again by a camera that moved, in three kinds of changed light
  name=$1 folder=$2
  shift 2
  relocbench build-dataset photographs "$folder" --name "$name" --size 512x512 --correspondences 1500 \
    --out "$out/photographs/$name" -q "$@"
}
train() { # TRAINER OPTION...
  trainer=$1
  shift
  relocbench train "$trainer" $(printf -- "-d $out/districts/%s " $(seq 21 37)) -d "$out/photographs/ie-tower" \
    -d "$out/photographs/landscapes" --set shares.ie-tower=0.15 --set shares.landscapes=0.05 \
    --out "$out/$trainer" --no-validation -q \
    --set steps=2400 --set scale=[0.44,1.0] --set encoder_weights=imagenet --set encoder_rate=0.3 \
    --set network.encoder=efficientnet-lite0 --set network.levels=5 --set loss.level_weights=[1,1,1,2,4] \
    --set loss.contrastive.away=2 "$@"
}
export OMP_NUM_THREADS=1 out
export -f district render
seq 21 37 | xargs -P 2 -I{} bash -euo pipefail -c 'render {}'
photographs ie-tower "$pictures/ie_tower" --licence "MIT, ie-tower-visual-place-recognition"
photographs landscapes "$pictures/landscapes" --licence "CC-BY-4.0, Aitzol Berasategi" --keyframes 20 --validation 0
train gn-net --set loss.ascent.weight=0.5 --set loss.pose.weight=0.2 --set network.confidence=true "$@" &
train gn-net-contrastive "$@" &
wait -n
wait -n
