"""Runs what docs/scaling/kubernetes.yaml and hyperqueue.sh run, and compares the merged shards with one run.

    python tests/python/schedulers.py GCS

Needs kubernetes-validate (which brings PyYAML) and hyperqueue.
"""

import os
import pathlib
import subprocess
import sys
import tempfile

import kubernetes_validate
import yaml

SHARDS = 3
SMALL = ["--points", "2.5,4", "--episodes", "6", "--controller", "crpl,rcc"]
TABLES = ["episodes.csv", "episodes.parquet", "points.csv"]
SCALING = pathlib.Path("docs/scaling")

# A stand-in for the program `hq`: the flags of hyperqueue.sh, and no others, to a server and a worker of its own.
HQ = """#!{python}
import argparse, os, sys
from hyperqueue import Job, LocalCluster
from hyperqueue.cluster import WorkerConfig

submit = argparse.ArgumentParser(prog="hq")
submit.add_argument("command", choices=["submit"])
submit.add_argument("--name", required=True)
submit.add_argument("--wait", action="store_true", required=True)
submit.add_argument("--array", required=True)
submit.add_argument("--cpus", type=int, required=True)
submit.add_argument("--crash-limit", type=int, required=True)
submit.add_argument("program", nargs="+")
flags = submit.parse_args()
first, last = map(int, flags.array.split("-"))
job = Job(max_fails=0)
assert first == 1
# HyperQueue numbers them from 0 here, and gives each its number as HQ_TASK_ID.
quiet = {{"stdout": None, "stderr": None, "cwd": os.getcwd()}}
job.program(["true"], **quiet)
for task in range(first, last + 1):
    job.program(flags.program, **quiet)
with LocalCluster({server!r}, worker_config=WorkerConfig(cores=2)) as cluster:
    client = cluster.client()
    client.wait_for_jobs([client.submit(job)])
"""


def run(command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"{command} ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def is_one_run(merged, whole, name):
    for table in TABLES:
        if (merged / table).read_bytes() != (whole / table).read_bytes():
            sys.exit(f"{name}: {table} differs from that of one run")
    print(f"{name}: {SHARDS} shards, merged, are one run byte for byte")


def kubernetes(gcs, dir, whole):
    """The Job against the schema, unknown keys refused; then each pod's command line, with paths of this machine."""
    job = yaml.safe_load((SCALING / "kubernetes.yaml").read_text())
    kubernetes_validate.validate(job, kubernetes_validate.latest_version(), strict=True)
    print(f"kubernetes: a {job['kind']} of the schema of {kubernetes_validate.latest_version()}")
    spec = job["spec"]
    pod = spec["template"]["spec"]
    container = pod["containers"][0]
    assert spec["completionMode"] == "Indexed" and spec["completions"] == spec["parallelism"]
    shards = {variable["name"]: variable["value"] for variable in container["env"]}["SHARDS"]
    assert int(shards) == spec["completions"], "SHARDS is not the number of completions"
    mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    assert set(mounts) == {volume["name"] for volume in pod["volumes"]} and mounts["results"] == "/results"
    (line,) = container["args"]
    line = line.replace("/results", str(dir)).replace("sweep_sigma", "sweep_bandwidth") + " " + " ".join(SMALL)
    for index in range(SHARDS):
        environment = {"PATH": f"{gcs.parent}:/usr/bin:/bin", "HOME": str(dir), "SHARDS": str(SHARDS)}
        run([*container["command"], line], env=environment | {"JOB_COMPLETION_INDEX": str(index)})
    folders = sorted(dir.glob("sigma/shard-*"))
    run([gcs, "merge", *folders, "--out", dir / "whole"])
    is_one_run(dir / "whole", whole, "kubernetes")


def hyperqueue(gcs, dir, whole):
    """The file itself, with the stand-in for `hq` first in PATH."""
    hq = dir / "bin" / "hq"
    hq.parent.mkdir()
    hq.write_text(HQ.format(python=sys.executable, server=str(dir / "server")))
    hq.chmod(0o755)
    environment = os.environ | {"PATH": f"{hq.parent}:{os.environ['PATH']}", "GCS": str(gcs)}
    out = dir / "shards"
    command = [SCALING / "hyperqueue.sh", "configs/sweep_bandwidth.toml", str(SHARDS), out, *SMALL]
    run(command, env=environment, timeout=500)
    is_one_run(out / "whole", whole, "hyperqueue")


def main(gcs):
    gcs = pathlib.Path(gcs)
    with tempfile.TemporaryDirectory() as home:
        home = pathlib.Path(home)
        whole = home / "one-run"
        run([gcs, "sweep", "--config", "configs/sweep_bandwidth.toml", "--threads", "1", "--out", whole, *SMALL])
        for name, check in [("kubernetes", kubernetes), ("hyperqueue", hyperqueue)]:
            dir = home / name
            dir.mkdir()
            check(gcs, dir, whole)


if __name__ == "__main__":
    main(sys.argv[1])
