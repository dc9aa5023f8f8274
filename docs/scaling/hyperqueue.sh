#!/usr/bin/env bash
# A sweep as a HyperQueue array: one shard a task, on whatever workers the server has.
#   hq server start & hq worker start &          # or `hq alloc add slurm ...`
#   docs/scaling/hyperqueue.sh CONFIG N OUT [more flags of `gcs sweep`]
set -euo pipefail
config=$1 shards=$2 out=$3
shift 3
gcs=${GCS:-target/release/gcs}

# HyperQueue fills in HQ_TASK_ID in the shell that it starts. A task that dies is started again and goes on.
hq submit --name crpl-sweep --wait --array "1-$shards" --cpus 1 --crash-limit 3 -- bash -c \
    'exec "$0" sweep --config "$1" --threads 1 --shard "$HQ_TASK_ID/$2" --out "$3/shard-$HQ_TASK_ID" "${@:4}"' \
    "$gcs" "$config" "$shards" "$out" "$@"

"$gcs" merge "$out"/shard-* --out "$out/whole"
