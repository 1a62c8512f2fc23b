#!/usr/bin/env bash
# Build the small datasets whose results are published in leaderboard/, from recordings and from the renderer.
#   tools/build_small_sets.sh RECORDINGS SCRATCH
set -euo pipefail
recordings=$(realpath "${1:?usage: tools/build_small_sets.sh RECORDINGS SCRATCH}")
scratch=${2:?usage: tools/build_small_sets.sh RECORDINGS SCRATCH}
cd "$(dirname "$0")/.."
export PATH="$PWD/${VENV:-.venv}/bin:$PATH"

kitti=$recordings/kitti_odometry
xyz=$recordings/tum_rgbd/rgbd_dataset_freiburg1_xyz
desk=$recordings/tum_rgbd/rgbd_dataset_freiburg1_desk
by_nc="CC BY-NC-SA 3.0 (KITTI)"
by="CC BY 4.0 (TUM RGB-D)"

relocbench build-dataset kitti "$kitti" --sequence 06 --pair-step 1,2,4,8 --licence "$by_nc" --out "$scratch/kitti_06" -q
rm -rf "$scratch/kitti_00_posed" # of a run that was cut off
python tools/kitti_lidar_poses.py "$kitti" 00 "$scratch/kitti_00_posed"
relocbench build-dataset kitti "$scratch/kitti_00_posed" --sequence 00 --depth velodyne --pair-step 1,2,3,4,5 --name kitti_00 --licence "$by_nc" --out "$scratch/kitti_00" -q
relocbench build-dataset kitti "$scratch/kitti_00_posed" --sequence 00 --depth stereo --pair-step 1,2,3,4,5 --name kitti_00_stereo --licence "$by_nc" --out "$scratch/kitti_00_stereo" -q
# The images of both confirm the clock as it was recorded, to 2 ms: traversal.yaml and inspect say so.
relocbench build-dataset tum-rgbd "$xyz" --time-offset 0 --pair-step 1,2,4 --name fr1_xyz --licence "$by" --out "$scratch/fr1_xyz" -q
relocbench build-dataset tum-rgbd "$desk" --time-offset 0 --pair-step 1,2,4 --name fr1_desk --licence "$by" --out "$scratch/fr1_desk" -q
relocbench build-dataset tum-rgbd "$xyz" "$desk" --time-offset 0 --name fr1_xyz_to_desk --licence "$by" --out "$scratch/fr1_xyz_to_desk" -q
rm -rf "$scratch/"{still,frankfurt_made,michigan_made,middlebury_made,oxford_made}
python tools/real_sets still-camera "$scratch/still" "$recordings/tilde_webcam/chamonix" "$recordings/tilde_webcam/courbevoie" "$recordings/tilde_webcam/mexico"
cat > "$scratch/webcams.yaml" << CONDITIONS
conditions:
  map: {tags: [a day]}
  chamonix: {tags: [another day, chamonix]}
  courbevoie: {tags: [another day, courbevoie]}
  mexico: {tags: [another day, mexico]}
CONDITIONS
relocbench build-dataset generic --config "$scratch/webcams.yaml" "$scratch/still/map" "$scratch/still/chamonix" "$scratch/still/courbevoie" "$scratch/still/mexico" --name webcams --licence "academic use only (AMOS, TILDE)" --out "$scratch/webcams" -q
made=$scratch/frankfurt_made
python tools/real_sets still-camera "$made" "$recordings/tilde_webcam/frankfurt" --night 115 --pairs 13
cat > "$scratch/frankfurt.yaml" << CONDITIONS
conditions:
  map: {tags: [day or night]}
  frankfurt_to_night: {time_of_day: night}
  frankfurt_to_day: {time_of_day: day}
CONDITIONS
relocbench build-dataset generic --config "$scratch/frankfurt.yaml" "$made/map" "$made/frankfurt_to_night" "$made/frankfurt_to_day" --time-offset 0 --name frankfurt --licence "academic use only (AMOS, TILDE)" --out "$scratch/frankfurt" -q
made=$scratch/middlebury_made
python tools/real_sets stereo-pairs "$made" "$recordings/middlebury_light/"{ArtL,Adirondack,Playtable,PlaytableP,Recycle}
cat > "$scratch/middlebury.yaml" << CONDITIONS
conditions:
  map: {tags: [left]}
  other_light: {tags: [right, other light]}
  same_light: {tags: [right, same light]}
CONDITIONS
relocbench build-dataset generic --config "$scratch/middlebury.yaml" "$made/map" "$made/other_light" "$made/same_light" --time-offset 0 --name middlebury --licence "use with citation (Middlebury Stereo Evaluation 3)" --out "$scratch/middlebury" -q
made=$scratch/oxford_made
python tools/real_sets homographies "$made" "$recordings/oxford_affine"
cat > "$scratch/oxford.yaml" << CONDITIONS
conditions:
  map: {tags: [first image]}
  light: {tags: [other exposure]}
  blur: {tags: [blurred]}
  compression: {tags: [compressed]}
  viewpoint: {tags: [other viewpoint]}
  zoom: {tags: [zoomed and rotated]}
CONDITIONS
relocbench build-dataset generic --config "$scratch/oxford.yaml" "$made/map" "$made/light" "$made/blur" "$made/compression" "$made/viewpoint" "$made/zoom" --time-offset 0 --max-distance 25 --max-angle 180 --name oxford --licence "not stated (Mikolajczyk et al. 2005)" --out "$scratch/oxford" -q
made=$scratch/michigan_made
python tools/real_sets shifted-images "$made" "$recordings/grief_michigan"
cat > "$scratch/michigan.yaml" << CONDITIONS
conditions:
  map: {tags: [a session]}
  seasons: {tags: [another session]}
CONDITIONS
relocbench build-dataset generic --config "$scratch/michigan.yaml" "$made/map" "$made/seasons" --time-offset 0 --name michigan --licence "not stated (GRIEF; images of NCLT, ODbL 1.0)" --out "$scratch/michigan" -q
relocbench build-dataset synthetic --preset demo --name town_demo --out "$scratch/town_demo" -q
