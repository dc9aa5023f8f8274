"""Several vehicles keep PettingZoo's rules, and fly what gcs fleet flies."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import crpl
from crpl.fleet import FleetFlight, make_fleet


@pytest.mark.parametrize("obs", ["state", "latent", "image"])
@pytest.mark.parametrize("actions", ["continuous", "discrete"])
def test_pettingzoo_finds_nothing_to_complain_of(obs, actions):
    env = make_fleet(crpl.scenario("demo", horizon=15), 3, obs, actions=actions, headway=3)
    parallel_api_test(env, num_cycles=60)


def test_equal_seeds_fly_equal_fleets():
    parallel_seed_test(lambda: make_fleet("moving", 2), num_cycles=60)


def test_one_vehicle_with_the_bandwidth_of_a_flight_flies_that_flight():
    world = crpl.scenario("demo")
    fleet, alone = make_fleet(world, 1, bandwidth=world["radio"]["b_dt"]), crpl.make(world)
    now, infos = fleet.reset(seed=3)
    observation, _ = alone.reset(seed=3000)
    assert (now["uav_0"] == observation).all() and infos["uav_0"] == {"seed": 3, "airborne": True}
    rng = np.random.default_rng(0)
    for _ in range(100):
        action = rng.uniform(-1, 1, 3).astype(np.float32)
        now, rewards, _, truncated, infos = fleet.step({"uav_0": action})
        observation, reward, _, over, info = alone.step(action)
        assert (now["uav_0"] == observation).all() and rewards["uav_0"] == reward
        assert infos["uav_0"]["snr_db"] == info["snr_db"]
    assert over and truncated["uav_0"] and fleet.agents == []
    assert infos["uav_0"]["metrics"] == info["metrics"]
    assert fleet.record_lines("uav_0") == alone.record_lines()


def test_pairs_leave_one_after_the_other_and_land_at_their_goal():
    fleet = make_fleet("demo", 3, headway=7)
    now, infos = fleet.reset(seed=0)
    assert [infos[agent]["airborne"] for agent in fleet.agents] == [True, True, False]
    left, ended = {}, {}
    for turn in range(200):
        now, rewards, terminated, truncated, infos = fleet.step({agent: _over(now[agent]) for agent in now})
        for agent, info in infos.items():
            if "snr_db" in info:
                left.setdefault(agent, turn)
            else:
                assert rewards[agent] == 0
            if terminated[agent] or truncated[agent]:
                ended[agent] = (terminated[agent], info["metrics"]["reached"])
        now = {agent: now[agent] for agent in fleet.agents}
        if not now:
            break
    assert left == {"uav_0": 0, "uav_1": 0, "uav_2": 7}
    assert ended == {agent: (True, True) for agent in left}


def _over(seen):
    """The way over the obstacle: each vehicle flies to the east in its own frame."""
    x, y, vx, vy = seen[:4]
    aim = (0.5, 0.75) if x < 0.4 else (0.9, 0.5)
    wish = [8 * (aim[0] - x) - 3 * vx, 8 * (aim[1] - y) - 3 * vy]
    return np.array([*np.clip(wish, -1, 1), 1], np.float32)


def test_a_meeting_is_told_to_both_and_costs():
    fleet = make_fleet("2", 2, collision_cost=2.5, bandwidth=6.0, headway=0)
    free = make_fleet("2", 2, collision_cost=0.0, bandwidth=6.0, headway=0)
    fleet.reset(seed=1), free.reset(seed=1)
    for _ in range(60):
        ahead = {agent: np.array([1, 0, 1], np.float32) for agent in fleet.agents}
        _, rewards, _, _, infos = fleet.step(ahead)
        _, rewards_free, *_ = free.step(ahead)
        if infos["uav_0"]["met"]:
            break
    assert infos["uav_1"]["met"] and fleet.encounters()[0] == 1
    assert rewards["uav_1"] == pytest.approx(rewards_free["uav_1"] - 2.5)


def test_what_is_wrong_is_told():
    with pytest.raises(ValueError, match="needs obs"):
        make_fleet("demo", 2, scheduler="predicted")
    with pytest.raises(ValueError, match="tdma, round-robin, predicted"):
        make_fleet("demo", 2, scheduler="fifo")
    with pytest.raises(ValueError, match="at least one"):
        make_fleet("demo", 0)
    fleet = make_fleet("demo", 2)
    fleet.reset(seed=0)
    with pytest.raises(ValueError, match="uav_1"):
        fleet.step({"uav_0": np.zeros(3, np.float32)})
    assert isinstance(fleet, FleetFlight)
