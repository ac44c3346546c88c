#!/usr/bin/env bash
# Streets of 100 to 1000 cameras, ours and Ceres in turn: growth.sh WORK, after the recipe in README.md.
set -e
work=$1
here=$(cd "$(dirname "$0")" && pwd)
solve=${CARGO_TARGET_DIR:-$here/../../target}/release/examples/solve
for cameras in 100 200 400 700 1000; do
  echo "== street of $cameras cameras"
  "$solve" bal "$work/street$cameras.txt" | grep lsfb
  "$work/ceres_bal" "$work/street$cameras.txt" sparse analytic
done
echo "== the largest without its reduced matrix"
"$solve" bal "$work/street1000.txt" iterative | grep lsfb
