"""Policy gradient by hand: a network learns to carry the tip along a moving pose, from the derivative of its own motion. Without a critic,
a teacher or inverse statics. `python examples/policy_gradient.py` takes a minute of one core; needs the extra `gradients`."""

import argparse
import time

import gymnasium as gym
import numpy as np
import torch

from soft_tendon_env.differentiable import Trajectories, rollout

ROWS, PERIODS, EPISODE = 64, 16, 250  # arms side by side; control periods of 20 ms per gradient, and per target
RATES = 2e-3, 3e-5  # learning rates, first and last
UNIT = torch.tensor([0.03] * 3 + [0.003] * 3)  # [rad], [m] from which on an error counts by its logarithm
FAR, SMOOTHNESS, WHIRL = 0.05, 3.0, 4.0  # weights of far errors and of changes of the action; [m/s] above which an arm begins anew
OBSERVED = "tip_position tip_rotation tip_twist tendon_lengths strain strain_rate target_error target_twist preview command".split()
OPTIONS = {"action": "increment", "observation": OBSERVED, "preview": [0.02, 0.04, 0.06, 0.1, 0.2], "sensors": 4, "history": 4}


def make_env(rows: int, fidelity: str) -> gym.vector.VectorEnv:
    return gym.make_vec("TendonRod-TipPose-v0", num_envs=rows, max_episode_steps=None, threads=1, fidelity=fidelity, **OPTIONS)


def cost_of(found: Trajectories) -> torch.Tensor:
    """Cauchy's cost, under which arms on their way do not hide those that are there, and a little of the distance, so that none whirls."""
    squares = (found.error / UNIT).square().sum(-1)
    return (0.5 * squares.log1p() + FAR * (1.0 + squares).sqrt()).mean() + SMOOTHNESS * found.action_change.square().mean()


def validation_error(policy: torch.nn.Module) -> float:
    """Root mean square position error [mm] after the first second, of 20 targets of 10 s that no training has met, at finer fidelity."""
    env, errors = make_env(20, "standard"), []
    observation, _ = env.reset(seed=10_000)
    for _ in range(500):
        with torch.no_grad():
            observation, *_, info = env.step(policy(torch.as_tensor(observation)).numpy())
        errors.append(info["position_error"])
    return 1e3 * float(np.sqrt(np.square(errors[50:]).mean()))


def main(seconds: float, reports: int = 10) -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)
    env, age = make_env(ROWS, "fast"), np.arange(ROWS) * EPISODE // ROWS  # so that not all targets begin together
    inputs, outputs = env.single_observation_space.shape[0], env.single_action_space.shape[0]
    layers = [torch.nn.Linear(inputs, 256), torch.nn.ELU(), torch.nn.Linear(256, 256), torch.nn.ELU(), torch.nn.Linear(256, outputs)]
    policy = torch.nn.Sequential(*layers)
    optimizer = torch.optim.Adam(policy.parameters())
    env.reset(seed=0)
    cost_of(rollout(env, policy, 1)).backward()  # compiles what is missing, which is no training
    spent = steps = reported = 0
    while spent < seconds:
        began = time.process_time()
        for group in optimizer.param_groups:
            group["lr"] = RATES[0] * (RATES[1] / RATES[0]) ** (spent / seconds)
        found = rollout(env, policy, PERIODS)
        optimizer.zero_grad()
        cost_of(found).backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimizer.step()
        age, speed = age + PERIODS, found.tip_twist[-1, :, 3:].detach().norm(dim=-1)
        if (over := (age >= EPISODE) | (speed > WHIRL).numpy() | found.diverged.any(0).numpy()).any():
            env.reset(options={"reset_mask": over})
            age[over] = 0
        spent, steps = spent + time.process_time() - began, steps + ROWS * PERIODS
        if spent >= (reported + 1) * seconds / reports:
            reported += 1
            print(f"{spent:5.1f} s, {steps:7,} steps: {validation_error(policy):6.2f} mm")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of training, CPU time")
    main(parser.parse_args().seconds)
