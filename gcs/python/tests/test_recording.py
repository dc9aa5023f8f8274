"""Recordings and run folders."""

import csv

import numpy as np
import pytest

import crpl


def test_exploration_is_recorded_in_both_formats(tmp_path):
    assert crpl.record_dataset(tmp_path / "a", "moving", episodes=2, pictures=25, seed=3) == 2
    assert sorted(p.name for p in (tmp_path / "a").glob("episode*")) == [
        "episode-00000.safetensors",
        "episode-00001.safetensors",
    ]
    with pytest.raises(ValueError, match="holds a recording"):
        crpl.record_dataset(tmp_path / "a", "moving")
    assert crpl.record_dataset(tmp_path / "a", "moving", episodes=3, pictures=25, seed=3, resume=True) == 3
    crpl.record_dataset(tmp_path / "b", "moving", episodes=1, pictures=25, seed=3, format="png")
    assert len(list((tmp_path / "b/episode-00000").glob("*.png"))) == 25


def test_a_policys_own_flights_are_recorded(tmp_path):
    def policy(picture):
        assert picture.shape == (100, 100, 3)
        return np.array([0.5, -0.25, 1.0], np.float32)

    world = crpl.scenario("demo", camera="hard")
    assert crpl.record_dataset(tmp_path, world, episodes=1, pictures=30, policy=policy, format="png") == 1
    rows = list(csv.DictReader((tmp_path / "episode-00000/steps.csv").read_text().splitlines()))
    assert len(rows) == 30 and float(rows[3]["action_x"]) == pytest.approx(0.5, abs=1e-5)
    assert rows[0]["power"] == "4" and rows[-1]["snr_db"] == ""
    assert (tmp_path / "truth/episode-00000.safetensors").exists()


def test_a_run_folder_is_read(tmp_path):
    lines = crpl._crpl.records("rcc", "two-obstacles", 0)
    (tmp_path / "record.jsonl").write_text(lines)
    (tmp_path / "config.toml").write_text("horizon = 100\n")
    (tmp_path / "run.json").write_text('{"controller": "rcc"}')
    run = crpl.read_run(tmp_path)
    assert len(run.records) == 100 and {"r_x", "v_next_y", "obstacle_1_x", "snr_db"} <= set(run.records)
    assert run.scenario["horizon"] == 100 and run.manifest["controller"] == "rcc"
