"""The environments keep Gymnasium's rules, and fly what gcs flies."""

import json

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import crpl

OBS = ["state", "latent", "image"]


@pytest.mark.parametrize("obs", OBS)
@pytest.mark.parametrize("actions", ["continuous", "discrete"])
@pytest.mark.filterwarnings("ignore:.*:UserWarning")
def test_gymnasium_finds_nothing_to_complain_of(obs, actions):
    env = crpl.make(crpl.scenario("moving", horizon=20), obs, actions=actions)
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("controller", ["crpl", "rcc"])
def test_the_actions_of_a_controller_give_its_records_to_the_last_byte(controller):
    lines = crpl._crpl.records(controller, "demo", 11)
    env = crpl.make("demo")
    env.reset(seed=11)
    for record in map(json.loads, lines.splitlines()):
        power = 1.0 if record["power"] == 4 else -1.0
        *_, truncated, info = env.step(np.array([*record["wish"], power], np.float32))
        assert info["outage"] == record["outage"] and info["p_coll"] == record["p_coll"]
        assert info["snr_db"] == np.float32(record["snr_db"]) and info["collided"] == record["collided"]
    assert truncated
    assert env.record_lines() == lines


def test_an_outage_holds_the_last_command():
    env = crpl.make(crpl.scenario("2", radio={"b_dt": 1.0}))
    env.reset(seed=0)
    *_, info = env.step(np.array([1, 0, -1], np.float32))
    assert info["outage"] and env.records()[0]["flown"] == [0.0, 0.0]


def test_the_reward_is_minus_the_stage_cost():
    env = crpl.make("demo")
    env.reset(seed=3)
    total, over = 0.0, False
    while not over:
        *_, reward, terminated, truncated, info = env.step(np.array([0.3, 0.1, 1], np.float32))
        total, over = total + reward, terminated or truncated
    assert truncated and not terminated
    assert total == pytest.approx(-info["metrics"]["j"], abs=1e-12)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(3, np.float32))


def test_a_fall_terminates():
    world = crpl.scenario("2", start=[0.36, 0.45], safety={"collision_action": "fall"})
    env = crpl.make(world)
    env.reset(seed=0)
    for _ in range(40):
        *_, terminated, truncated, info = env.step(np.array([1, 0, 1], np.float32))
        if terminated:
            break
    assert terminated and not truncated and info["collided"] and info["metrics"]["collisions"] == 1


@pytest.mark.parametrize("obs", OBS)
@pytest.mark.parametrize("threads", [1, 2])
def test_a_batch_flies_what_single_flights_fly(obs, threads):
    world = crpl.scenario("moving", horizon=30)
    batch = crpl.make_vec(world, 5, obs, threads=threads)
    alone = [crpl.make(world, obs) for _ in range(5)]
    now, infos = batch.reset(seed=20)
    assert list(infos["seed"]) == [20, 21, 22, 23, 24]
    assert (now == np.stack([env.reset(seed=20 + n)[0] for n, env in enumerate(alone)])).all()
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.uniform(-1, 1, (5, 3)).astype(np.float32)
        now, rewards, terminated, truncated, infos = batch.step(actions)
        for n, env in enumerate(alone):
            observation, reward, _, _, info = env.step(actions[n])
            assert (now[n] == observation).all() and rewards[n] == reward
            assert infos["snr_db"][n] == info["snr_db"]
    assert truncated.all() and not terminated.any()
    assert infos["_metrics"].all() and infos["metrics"]["j"][4] == info["metrics"]["j"]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_next_flight_begins_as_the_mode_says(mode):
    world = crpl.scenario("demo", horizon=3)
    batch = crpl.make_vec(world, 2, autoreset_mode=mode)
    assert batch.metadata["autoreset_mode"] == mode
    batch.reset(seed=0)
    actions = np.ones((2, 3), np.float32)
    for _ in range(3):
        now, _, _, truncated, infos = batch.step(actions)
    assert truncated.all() and infos["_metrics"].all()
    if mode == AutoresetMode.SAME_STEP:
        assert (now[:, 7] == 0).all() and infos["final_obs"][0][7] == 1
        assert batch.seeds() == [2, 3]
    else:
        assert (now[:, 7] == 1).all() and batch.seeds() == [0, 1]
        now, rewards, _, truncated, infos = batch.step(actions)
        assert not truncated.any() and not infos["_snr_db"].any() and (rewards == 0).all()
        assert batch.seeds() == ([2, 3] if mode == AutoresetMode.NEXT_STEP else [0, 1])
    if mode == AutoresetMode.DISABLED:
        now, _ = batch.reset(seed=5, options={"reset_mask": np.array([False, True])})
        assert batch.seeds() == [0, 6] and list(now[:, 7]) == [1, 0]


def test_observations_are_in_their_space():
    for obs in OBS:
        batch = crpl.make_vec("two-obstacles", 3, obs)
        now, _ = batch.reset(seed=1)
        assert now in batch.observation_space
        for _ in range(120):
            now, *_ = batch.step(batch.action_space.sample())
            assert now in batch.observation_space


def test_what_is_wrong_is_told():
    with pytest.raises(ValueError, match="no scenario|nowhere"):
        crpl.make("nowhere")
    with pytest.raises(ValueError, match="bandwith"):
        crpl.scenario("2", radio={"bandwith": 2.0})
    with pytest.raises(ValueError, match="horizon"):
        crpl.make(crpl.scenario("2", horizon=0))
    with pytest.raises(ValueError, match="state, latent or image"):
        crpl.make("demo", "lidar")
    env = crpl.make("demo")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="finite"):
        env.step(np.array([np.nan, 0, 0], np.float32))
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(2, np.float32))


def test_without_a_seed_flights_are_drawn_from_the_last_seed():
    def seeds():
        env = crpl.make("demo")
        return [env.reset(seed=4)[1]["seed"]] + [env.reset()[1]["seed"] for _ in range(3)]

    assert seeds() == seeds() and len(set(seeds())) == 4
