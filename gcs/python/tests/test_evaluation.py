"""Scores are those of gcs, and pairs stay pairs."""

import numpy as np
import pandas as pd
import pytest

import crpl

SEEDS = range(40, 46)


def test_crpl_from_python_is_crpl():
    world = crpl.WorldModel.load("learned")
    ours = crpl.score(world.policy("demo"), "demo", SEEDS, obs="latent", name="crpl")
    pd.testing.assert_frame_equal(ours, crpl.fly("crpl", "demo", SEEDS), check_dtype=False, check_exact=True)


def test_a_table_has_every_metric_and_ratios_of_pairs():
    def east(observation):
        return np.array([1.0 if observation[2] < 0.3 else 0.0, 0.0, 1.0], np.float32)

    table = crpl.evaluate(east, "demo", SEEDS, against=["crpl", "rcc"], name="east")
    assert list(table.index.levels[0].sort_values()) == ["crpl", "east", "rcc"]
    assert set(crpl.metrics().index) | {"reached", "below", "at_wall"} == set(table.loc["east"].index)
    assert (table.loc["crpl"].loc[["j", "e_comm"], "ratio"] == 1).all()
    flights = crpl.fly("rcc", "demo", SEEDS), crpl.fly("crpl", "demo", SEEDS)
    assert table.loc[("rcc", "j"), "ratio"] == pytest.approx(flights[0]["j"].mean() / flights[1]["j"].mean())
    row = table.loc[("east", "e_comm")]
    assert row["mean"] == 400 and row["lo"] == row["hi"] == 400 and row["ratio"] == pytest.approx(4.0)


def test_one_call_an_observation_or_one_a_batch_is_the_same():
    def one(observation):
        return np.clip(observation[[0, 1, 4]], -1, 1)

    def batch(observations):
        return np.clip(observations[:, [0, 1, 4]], -1, 1)

    a = crpl.score(one, "demo", SEEDS)
    b = crpl.score(batch, "demo", SEEDS, batched=True)
    pd.testing.assert_frame_equal(a, b)


def test_a_controller_with_a_state_gets_a_copy_for_each_flight():
    class Counter:
        calls = 0

        def reset(self):
            self.calls = 0

        def __call__(self, observation):
            assert observation[7] == np.float32(self.calls / 100)
            self.calls += 1
            return np.zeros(3, np.float32)

    counter = Counter()
    assert len(crpl.score(counter, "demo", SEEDS)) == 6 and counter.calls == 0


def test_an_object_that_predicts_is_asked_for_its_best():
    class Agent:
        def predict(self, observations, deterministic=False):
            assert deterministic and observations.shape == (6, 12)
            return np.zeros((6, 3), np.float32), None

    assert (crpl.score(Agent(), "demo", SEEDS)["ticks"] == 100).all()


def test_other_seeds_are_no_pairs():
    with pytest.raises(ValueError, match="different seeds"):
        crpl.compare(pd.concat([crpl.fly("rcc", "demo", [1, 2]), crpl.fly("ucc", "demo", [1, 3])]))


def test_a_world_that_no_policy_covers_is_refused():
    with pytest.raises(ValueError, match="another world"):
        crpl.fly("crpl", crpl.scenario("demo", goal=[0.9, 0.8]), [0])
    with pytest.raises(ValueError, match="nobody"):
        crpl.fly("nobody", "demo", [0])
