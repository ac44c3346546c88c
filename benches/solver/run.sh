#!/usr/bin/env bash
# Ours and the peers' in turn: run.sh WORK PYTHON DATA, after the recipe in README.md.
set -e
work=$1 python=$2 data=$3
here=$(cd "$(dirname "$0")" && pwd)
solve=${CARGO_TARGET_DIR:-$here/../../target}/release/examples/solve
zcat "$data/vision/ba/problem-16-22106-pre.txt.gz" > "$work/bal16.txt"
zcat "$data/vision/posegraph/parking-garage.g2o.gz" > "$work/garage.g2o"
zcat "$data/vision/posegraph/sphere2500.g2o.gz" > "$work/sphere.g2o"
for turn in 1 2 3; do
  echo "== BAL 16-22106, turn $turn"
  "$solve" bal "$work/bal16.txt" | grep lsfb
  for kind in "dense analytic" "dense auto" "sparse analytic" "sparse auto"; do
    "$work/ceres_bal" "$work/bal16.txt" $kind
  done
  echo "== street of gen.py, turn $turn"
  "$solve" bal "$work/gen200.txt" | grep lsfb
  "$work/ceres_bal" "$work/gen200.txt" sparse analytic
  "$work/ceres_bal" "$work/gen200.txt" dense analytic
  for graph in garage sphere torus; do
    echo "== pose graph $graph, turn $turn"
    "$solve" pose-graph "$work/$graph.g2o" | grep lsfb
    "$python" "$here/gtsam_pose_graph.py" "$work/$graph.g2o"
  done
done
for turn in 1 2; do
  echo "== stereo factors KITTI-00, turn $turn"
  "$solve" stereo "$work/kitti00" 00.txt
  "$python" "$here/gtsam_stereo.py" "$work/kitti00" 00.txt
done
"$here/growth.sh" "$work"
echo "== growing walk"
"$solve" growing 1000 60
echo "== stereo and inertial tracks, keyframe by keyframe"
"${solve%solve}incremental_tracks" "$data/vision/vi_tracks_seq90.tar.gz"
mkdir -p "$work/tracks" && tar xzf "$data/vision/vi_tracks_seq90.tar.gz" -C "$work/tracks"
"$python" "$here/isam2_tracks.py" "$work/tracks"
