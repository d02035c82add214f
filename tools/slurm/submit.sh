#!/bin/bash
# Bakes one table as a Slurm job array and merges it when every shard is there.
#   tools/slurm/submit.sh akoya.json 10000000 64 akoya.exr
# Further arguments of bake-brdf: BAKE_ARGUMENTS="--azimuth walk" tools/slurm/submit.sh …
set -euo pipefail
[ $# -eq 4 ] || { echo "submit.sh: expected RECIPE PATHS SHARDS OUTPUT, got $# arguments" >&2; exit 2; }
export RECIPE=$1 PATHS=$2 OUTPUT=$4 SHARDS=$4.shards BAKE_ARGUMENTS=${BAKE_ARGUMENTS:-}
here=$(dirname "$0")
mkdir -p "$SHARDS"
array=$(sbatch --parsable --export=ALL --array="1-$3" "$here/shard.sbatch")
sbatch --export=ALL --dependency="afterok:$array" "$here/merge.sbatch"
