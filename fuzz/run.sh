#!/bin/bash
# A million executions of every target under its sanitiser, from the seeds and the damaged files; a table on stdout.
#
#     cargo install cargo-fuzz && rustup toolchain install nightly
#     fuzz/run.sh [EXECUTIONS [TARGET…]]
#
# FUZZ_BINARIES names a folder of targets built before (`cargo +nightly fuzz build`), to be run as they are.
# A finding ends its target: its input is left in fuzz/artifacts, to be kept in fuzz/damaged.
set -eu
cd "$(dirname "$0")/.."
executions=${1:-1000000}
shift || true
targets=${*:-$(cd fuzz/fuzz_targets && ls ./*.rs | sed 's|^\./||; s|\.rs$||')}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

echo "| target | executions | edges (cov) | features (ft) | corpus grown to | peak memory, MB | executions a second | findings |"
echo "|---|---|---|---|---|---|---|---|"
mkdir -p fuzz/artifacts
for target in $targets; do
  mkdir "$work/$target"
  log=$work/$target.log
  findings=0
  if [ -n "${FUZZ_BINARIES:-}" ]; then
    run=("$FUZZ_BINARIES/$target" -artifact_prefix=fuzz/artifacts/)
  else
    cargo +nightly fuzz build "$target" >&2
    run=(fuzz/target/*/release/"$target" -artifact_prefix=fuzz/artifacts/)
  fi
  "${run[@]}" "$work/$target" "fuzz/corpus/$target" "fuzz/damaged/$target" \
    -runs="$executions" -seed=1 -max_len=16384 -rss_limit_mb=1024 -timeout=120 -print_final_stats=1 >"$log" 2>&1 || findings=1
  [ "$findings" = 0 ] || { echo "$target:"; tail -n 40 "$log"; } >&2
  last=$(grep -E '^#[0-9]+.* cov: ' "$log" | tail -n 1)
  word() { sed -nE "s/.* $1: ([^ ]+).*/\1/p" <<<"$last"; }
  stat() { sed -nE "s/^stat::$1: *//p" "$log"; }
  echo "| $target | $(stat number_of_executed_units) | $(word cov) | $(word ft) | $(word corp) | $(stat peak_rss_mb) | $(stat average_exec_per_sec) | $findings |"
done
