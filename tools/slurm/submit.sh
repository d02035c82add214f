#!/bin/bash
# Bakes one table as a Slurm job array and merges it when every shard is there.
#   tools/slurm/submit.sh akoya.json 10000000 64 akoya.exr
# Further arguments of bake-brdf: BAKE_ARGUMENTS="--azimuth space" tools/slurm/submit.sh …
set -euo pipefail
[ $# -eq 4 ] || { echo "submit.sh: expected RECIPE PATHS SHARDS OUTPUT, got $# arguments" >&2; exit 2; }
export RECIPE=$1 PATHS=$2 SHARD_COUNT=$3 OUTPUT=$4 SHARDS=$4.shards BAKE_ARGUMENTS=${BAKE_ARGUMENTS:-}
here=$(dirname "$0")
# What the shards must say that they hold, so that shards left from another bake are refused; a wrong recipe is refused here.
# shellcheck disable=SC2086 # arguments are words
forecast=$(bake-brdf "$RECIPE" --paths "$PATHS" $BAKE_ARGUMENTS --dry-run --json --quiet)
export CONTENT
CONTENT=$(sed -nE 's/.*"content_hash": "([0-9a-f]+)".*/\1/p' <<<"$forecast")
mkdir -p "$SHARDS"
# JOB or, where Slurm joins several clusters, JOB;CLUSTER: a job depends on jobs of its own cluster only.
array=$(sbatch --parsable --export=ALL --array="1-$SHARD_COUNT" "$here/shard.sbatch")
IFS=';' read -r job cluster <<<"$array"
sbatch ${cluster:+--clusters="$cluster"} --export=ALL --dependency="afterok:$job" "$here/merge.sbatch"
