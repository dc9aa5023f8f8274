"""The program gcs and the package fly the same flight. CRPL_GCS names the program; without it there is nothing to ask."""

import os
import subprocess

import numpy as np
import pytest

import crpl


@pytest.mark.skipif("CRPL_GCS" not in os.environ, reason="CRPL_GCS names no gcs")
def test_an_environment_gives_the_bytes_of_gcs(tmp_path):
    flags = ["--scenario", "gusty", "--controller", "rcc,crpl-bw", "--policy-mismatch", "allow", "--seed", "6"]
    subprocess.run([os.environ["CRPL_GCS"], "demo", *flags, "--out", tmp_path], check=True, stdout=subprocess.DEVNULL)
    run = crpl.read_run(tmp_path / "rcc")
    env = crpl.make(run.scenario)
    env.reset(seed=run.manifest["seed"])
    for row in run.records.itertuples():
        power = 1.0 if row.power == 4 else -1.0
        *_, info = env.step(np.array([row.wish_x, row.wish_y, power], np.float32))
    assert env.record_lines() == (tmp_path / "rcc/record.jsonl").read_text()
    assert info["metrics"]["j"] == run.manifest["summary"]["j"]
    score = crpl.fly("rcc", run.scenario, [6])
    assert score["j"][0] == run.manifest["summary"]["j"]
