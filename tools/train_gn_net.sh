#!/usr/bin/env bash
# Train the weights of gn-net and gn-net-contrastive from nothing but EfficientNet-Lite0's ImageNet weights, in two
# stages: seventeen districts and photographs whose camera moved a little; then sixteen districts of wide pairs, months
# apart and by changed cameras, and cube maps seen at other angles and scales. The two networks train side by side.
#   tools/train_gn_net.sh OUT PHOTOGRAPHS [OPTION...]       OPTION: of `relocbench train gn-net`, such as --set seed=1
# PHOTOGRAPHS holds ie_tower/ (480 frames of walks through a building, 1280x720, every second one of the repository
# JSebastianIEU/ie-tower-visual-place-recognition, commit ea8bdfab, MIT), landscapes/ (the five by Aitzol
# Berasategi in Debian's package lomiri-wallpapers-16.04, CC-BY-4.0), and the cube maps polyhaven_cubemaps/,
# polyhaven_street_views/ (CC0) and humus_cubemaps/ (Emil Persson, CC-BY-3.0); docs/training.md says where they are.
# OUT gets districts/, photographs/, first/, gn-net/ and gn-net-contrastive/. A run that was killed goes on where it
# stopped. Less than five hours on two cores; needs the extra `pretrained`.
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
wide() { # SEED: four conditions, 2 to 16 m apart, cameras and months changed
  all=(Sunny Rain Night Fog WetNoon Neutral Overcast Snow SoftRainNoon WetCloudySunset)
  months=(3 6 12) n=$(($1 - 301))
  relocbench build-dataset synthetic --split train --seed "$1" --extent 250 --steps 50 --size 512 --reference others \
    --conditions "${all[n % 10]},${all[(n + 3) % 10]},${all[(n + 7) % 10]},${all[(n + 2) % 10]}" \
    --speed 16 --lateral 1.5 --heading 4 --min-distance 2 --max-distance 16 --max-angle 50 --imaging varied \
    --months "${months[n % 3]}" --views varied --correspondences 1500 --repeating-street avoid --name "hard-$1" \
    --out "$out/districts/$1" -j 1 -q
  echo "rendered district $1"
}
photographs() { # NAME LICENCE OPTION... FOLDER...: each seen again by a camera that moved, in several kinds of light
  name=$1 licence=$2
  shift 2
  relocbench build-dataset photographs "$@" --name "$name" --licence "$licence" --correspondences 1500 \
    --out "$out/photographs/$name" -q
}
train() { # TRAINER OPTION...
  trainer=$1
  shift
  relocbench train "$trainer" --no-validation -q --set scale=[0.44,1.0] --set encoder_rate=0.3 \
    --set network.encoder=efficientnet-lite0 --set network.levels=5 --set loss.level_weights=[1,1,1,2,4] \
    --set loss.contrastive.away=2 "$@"
}
both_stages() { # TRAINER OPTION...
  trainer=$1
  shift
  train "$trainer" $(printf -- "-d $out/districts/%s " $(seq 21 37)) -d "$out/photographs/ie-tower" \
    -d "$out/photographs/landscapes" --set shares.ie-tower=0.15 --set shares.landscapes=0.05 \
    --out "$out/first/$trainer" --set steps=2400 --set encoder_weights=imagenet "$@"
  train "$trainer" $(printf -- "-d $out/districts/%s " $(seq 301 316)) -d "$out/photographs/polyhaven" \
    -d "$out/photographs/humus" --set shares.polyhaven=0.2 --set shares.humus=0.05 \
    --out "$out/$trainer" --set "start=$out/first/$trainer/weights.safetensors" \
    --set steps=1000 --set warm_up=50 --set learning_rate=0.0015 --set ema=0.99 "$@"
}
export OMP_NUM_THREADS=1 out
export -f district render wide
seq 21 37 | xargs -P 2 -I{} bash -euo pipefail -c 'render {}'
seq 301 316 | xargs -P 2 -I{} bash -euo pipefail -c 'wide {}'
photographs ie-tower "MIT, ie-tower-visual-place-recognition" --size 512x512 "$pictures/ie_tower"
photographs landscapes "CC-BY-4.0, Aitzol Berasategi" --size 512x512 --keyframes 20 --validation 0 "$pictures/landscapes"
changes=exposure,lamplight,fog,snow,low-sun
photographs polyhaven CC0-1.0 --size 384 --viewpoint strong --changes $changes --keyframes 4 \
  "$pictures/polyhaven_cubemaps" "$pictures/polyhaven_street_views"
photographs humus "CC-BY-3.0, Emil Persson" --size 384 --viewpoint strong --changes $changes --keyframes 8 \
  "$pictures/humus_cubemaps"
both_stages gn-net --set loss.ascent.weight=0.5 --set loss.pose.weight=0.2 --set network.confidence=true "$@" &
both_stages gn-net-contrastive "$@" &
wait -n
wait -n
