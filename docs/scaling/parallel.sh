#!/usr/bin/env bash
# A sweep in N shards with GNU parallel: on this machine, or on those in $SSHLOGINFILE (a shared folder, the
# program in the same place).
#   docs/scaling/parallel.sh CONFIG N OUT [more flags of `gcs sweep`]
set -euo pipefail
config=$1 shards=$2 out=$3
shift 3
gcs=${GCS:-target/release/gcs}

# --retries: a shard that dies resumes. --joblog says how long each took.
mkdir -p "$out"
seq "$shards" | parallel --will-cite --quote --halt soon,fail=1 --retries 3 --joblog "$out/jobs.log" \
    ${SSHLOGINFILE:+--sshloginfile "$SSHLOGINFILE" --workdir .} \
    "$gcs" sweep --config "$config" --shard "{}/$shards" --threads 1 --out "$out/shard-{}" "$@" > /dev/null

"$gcs" merge "$out"/shard-* --out "$out/whole"
