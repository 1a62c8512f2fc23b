#!/usr/bin/env bash
# Reproduce the results in leaderboard/: datasets and predictions in a scratch folder, tables in the repository.
#   tools/publish_leaderboard.sh RECORDINGS [SCRATCH]
# RECORDINGS holds kitti_odometry/ (official layout, sequences 00 and 06), tum_rgbd/ (freiburg1_xyz, freiburg1_desk),
# tilde_webcam/ (chamonix, courbevoie, mexico, frankfurt), middlebury_light/ (scenes of the Stereo Evaluation 3),
# oxford_affine/ (eight scenes) and grief_michigan/. Where it has weights/aliked-n16.pth, aliked-pnp is run as well, and
# gn-net's alignment from its pose.
set -euo pipefail
recordings=$(realpath "${1:?usage: tools/publish_leaderboard.sh RECORDINGS [SCRATCH]}")
scratch=${2:-$(mktemp -d)}
cd "$(dirname "$0")/.."
export PATH="$PWD/${VENV:-.venv}/bin:$PATH"

tools/build_small_sets.sh "$recordings" "$scratch"

learned=()
if [ -f "$recordings/weights/aliked-n16.pth" ]; then
  export TORCH_HOME=$scratch/torch # where the method looks: no path of this machine becomes a parameter
  mkdir -p "$TORCH_HOME/hub/checkpoints"
  ln -sf "$recordings/weights/aliked-n16.pth" "$TORCH_HOME/hub/checkpoints/"
  learned=(-m aliked-pnp -m gn-net-from-aliked-pnp=gn-net-from-prior --set gn-net-from-aliked-pnp.start=aliked-pnp \
    --set gn-net-from-aliked-pnp.prior_level=2 --set gn-net-from-aliked-pnp.min_agreement=0)
fi

for dataset in kitti_06 kitti_00 kitti_00_stereo fr1_xyz fr1_desk fr1_xyz_to_desk webcams frankfurt middlebury oxford town_demo; do
  relocbench evaluate -d "$scratch/$dataset" --out "$scratch/results" --workers 1 --overwrite always --matching -q \
    -m identity -m orb-pnp -m sift-pnp -m dso -m dso-full-cutoff=dso --set dso-full-cutoff.cutoff_levels=16 \
    -m dso-multistart -m gn-net -m gn-net-from-prior -m gn-net-pnp -m clock \
    -m gn-net-contrastive -m lm-net -m lm-net-from-prior "${learned[@]}"
done
relocbench evaluate -d "$scratch/michigan" --out "$scratch/shifts" --workers 1 --overwrite always -q -m identity -m orb-pnp -m sift-pnp \
  -m gn-net -m gn-net-contrastive -m gn-net-from-prior "${learned[@]}"
relocbench probe -d "$scratch/webcams" -m gn-net-from-prior -m gn-net-contrastive -m dso --no-poses --structured 0.25 \
  --out "$scratch/webcams_probe" --workers 1 -q
rm -rf leaderboard/{predictions,sets,reading.md,leaderboard.md,real/webcams_probe,real/predictions} leaderboard/*.csv
python benchmarks/publish/shifts.py "$scratch/michigan" "$scratch/shifts" --out leaderboard/real
python benchmarks/publish/archives.py "$scratch/shifts" leaderboard/real/predictions
mkdir -p leaderboard/real/webcams_probe
cp "$scratch"/webcams_probe/{probe.md,probe.csv,radii.csv,curves.png,levels.png} leaderboard/real/webcams_probe/
relocbench leaderboard "$scratch/results" --out leaderboard
python benchmarks/publish/archives.py "$scratch/results" leaderboard/predictions # tools/recompute.py begins with them
python benchmarks/publish/real.py --board leaderboard --out leaderboard/real
