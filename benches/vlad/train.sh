#!/usr/bin/env bash
# Trains the codebook that is built in (pipeline/src/vlad/default.codebook), on the backpack's images of the nine simulated places.
# usage: benches/vlad/train.sh WORK
set -euo pipefail
lsfb=$(dirname "$0")/../../target/release/lsfb
"$lsfb" bench twin --quick --seed 46 --device android --keep-recordings --out "$1/trial"
"$lsfb" models codebook "$1"/trial/*-46/scan.mcap --out "$1/default.codebook"
sha256sum "$1/default.codebook"
