#!/usr/bin/env bash
# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
# From the command line: what the model lacks by a log, then the errors of the augmented model.
set -euo pipefail
cd "$(dirname "$0")"
out=${1:-report}
puma-sim explain pendulum.csv --plant pendulum --out "$out"
# open-loop windows of half a second against the log
puma-sim simulate pendulum.csv --model "$out/model.yaml" --restart 0.5 --out "$out/run.csv"
