"""A PyTorch policy that imitates CRPL from latents, then flies: python examples/python/torch_policy.py"""

import numpy as np
import torch

import crpl


def demonstrations(flights):
    """Latents, and CRPL's actions on them."""
    policy = crpl.WorldModel.load().policy("demo")
    env = crpl.make_vec("demo", flights, "latent", autoreset_mode="Disabled")
    now, _ = env.reset(seed=0)
    seen, done = [], []
    for _ in range(env.scenario["horizon"]):
        actions = policy(now)
        seen.append(now)
        done.append(actions)
        now, *_ = env.step(actions)
    return np.concatenate(seen), np.concatenate(done)


def main():
    torch.manual_seed(0)
    torch.set_num_threads(1)
    x, a = (torch.from_numpy(values) for values in demonstrations(64))
    mean, std = x.mean(0), x.std(0) + 1e-3
    net = torch.nn.Sequential(torch.nn.Linear(10, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh(), torch.nn.Linear(64, 3))
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(1500):
        pick = torch.randint(len(x), (512,))
        loss = (net((x[pick] - mean) / std) - a[pick]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    def policy(observations):
        with torch.no_grad():
            return net((torch.from_numpy(observations) - mean) / std).numpy()

    table = crpl.evaluate(
        policy, "demo", range(500, 550), against=["crpl"], obs="latent", batched=True, name="imitation"
    )
    print(table.round(3).to_string())


if __name__ == "__main__":
    main()
