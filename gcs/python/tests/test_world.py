"""The world model on arrays."""

import numpy as np
import pytest

import crpl


@pytest.fixture(scope="module", params=["centroid", "learned"])
def world(request):
    return crpl.WorldModel.load(request.param)


def frames(count=8, scenario="moving"):
    env = crpl.make_vec(scenario, 1, "image")
    now, _ = env.reset(seed=2)
    pictures, states = [now[0]], [[env.scenario["start"], env.scenario["obstacle"][0]["position"]]]
    state = crpl.make(scenario)
    state.reset(seed=2)
    for _ in range(count - 1):
        action = np.array([[0.3, 0.1, 1]], np.float32)
        pictures.append(env.step(action)[0][0])
        observation = state.step(action[0])[0]
        states.append([observation[:2], observation[8:10]])
    return np.stack(pictures), np.array(states, np.float64)


def test_pictures_become_latents_that_tell_the_places(world):
    pictures, truth = frames()
    z = world.encode(pictures)
    assert z.shape == (8, 2, 16) and z.dtype == np.float32
    assert (z == np.stack([world.encode(picture[None])[0] for picture in pictures])).all()
    y = world.plane(z)
    assert np.abs(world.places(y) - truth).max() < 0.01
    assert np.abs(world.places(world.planes_at(truth)) - truth).max() < 1e-4


def test_the_observer_and_the_predictor_follow_a_flight(world):
    pictures, truth = frames(40, "2")
    observer = world.observer("2")
    y = observer.observe(pictures[0])
    for picture in pictures[1:10]:
        y = observer.observe(picture, [[0.3, 0.1]])
    ahead = world.predict(y[0][None], y[1][None], np.tile([0.3, 0.1], (1, 8, 1)))
    assert ahead.shape == (1, 8, 2)
    both = np.stack([ahead[0], np.repeat(y[2][None], 8, 0)], axis=1)
    assert np.abs(world.places(both)[:, 0] - truth[10:18, 0]).max() < 0.02


def test_the_heads_know_risk_and_shadow(world):
    near, far = [[0.5, 0.55], [0.5, 0.45]], [[0.1, 0.5], [0.5, 0.45]]
    y = world.planes_at(np.array([near, far]))
    risk, gain = world.risk(y, "2"), world.gain(y, "2")
    assert risk[0] > 0.5 > 0.05 > risk[1]
    assert 10 * np.log10(gain[1] / gain[0]) > 3
    with pytest.raises(ValueError, match="path_loss_exponent"):
        world.gain(y, crpl.scenario("2", channel={"path_loss_exponent": 3.0}))


def test_policies_are_called_on_one_observation_or_many():
    policy = crpl.WorldModel.load().policy("demo")
    env = crpl.make_vec("demo", 4, "latent")
    now, _ = env.reset(seed=0)
    actions = policy(now)
    assert actions.shape == (4, 3) and (policy(now[1]) == actions[1]).all()
    assert "built-in" in policy.source


def test_shapes_are_checked():
    world = crpl.WorldModel.load()
    with pytest.raises(ValueError, match="shape"):
        world.encode(np.zeros((2, 64, 64, 3), np.uint8))
    with pytest.raises(ValueError, match="rows"):
        world.predict(np.zeros((2, 2)), np.zeros((1, 2)), np.zeros((2, 3, 2)))
