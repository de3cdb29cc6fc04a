"""PPO in one file, in the manner of CleanRL: torch alone, many arms side by side.
`python examples/ppo_cleanrl.py --help`

Ended episodes are reset by the vector environment, in one of two ways of Gymnasium, and both are
handled here:

- "same_step": the step that ends an episode returns the first observation of the next one. What it
ended with is in info["final_obs"].
- "next_step": that step returns what the episode ended with. The next step resets the row and
ignores its action: it is no transition.

An episode that was truncated would have gone on: its last reward is followed by the value of what
it ended with. Only one that terminated, because the simulation diverged, is followed by none.
"""

import argparse
import time
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import soft_tendon_env  # noqa: F401 # registers the ids
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--id",
        default="TendonRod-TipPose-v0",
        help="of an environment whose observation is one array",
    )
    parser.add_argument("--steps", type=int, default=400_000, help="of all rows together")
    parser.add_argument("--rows", type=int, default=64, help="arms side by side")
    parser.add_argument(
        "--rollout", type=int, default=32, help="steps of every row between two updates"
    )
    parser.add_argument(
        "--episode", type=int, default=150, help="steps after which an episode is truncated"
    )
    parser.add_argument("--autoreset", choices=("same_step", "next_step"), default="same_step")
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=1e-3,
        help="at first; it falls in a straight line to a tenth",
    )
    parser.add_argument(
        "--gamma",
        type=float,
        default=0.95,
        help="about half a second ahead: an arm comes to rest within it",
    )
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--batch", type=int, default=512, help="transitions of a minibatch")
    parser.add_argument(
        "--clip",
        type=float,
        default=0.2,
        help="greatest change of a probability that is rewarded, as a share",
    )
    parser.add_argument(
        "--target-kl",
        type=float,
        default=0.03,
        help="divergence from the last policy at which an update ends",
    )
    parser.add_argument("--value-weight", type=float, default=0.5)
    parser.add_argument("--greatest-gradient", type=float, default=0.5, help="its norm")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--difficulty", choices=("easy", "medium", "hard"), default="easy")
    return parser.parse_args()


class Agent(nn.Module):
    """Gaussian policy, and value function."""

    def __init__(self, observed: int, actions: int) -> None:
        super().__init__()
        self.mean = network(observed, actions, 0.01)
        self.log_std = nn.Parameter(torch.zeros(actions))
        self.value = network(observed, 1, 1.0)

    def distribution(self, observation: torch.Tensor) -> Normal:
        return Normal(self.mean(observation), self.log_std.exp())

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """The interface of Stable-Baselines3, with which everything here is evaluated."""
        with torch.no_grad():
            return self.mean(torch.as_tensor(observation)).numpy(), state


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, outputs)]
    for layer, scale in zip(layers, (np.sqrt(2.0), np.sqrt(2.0), gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


class Batch(NamedTuple):
    """Transitions of a rollout, (m, ..) each."""

    observation: torch.Tensor
    action: torch.Tensor
    log_probability: torch.Tensor
    advantage: torch.Tensor
    value_target: torch.Tensor


class Rollouts:
    """Transitions of all rows, one rollout after the other."""

    def __init__(
        self, envs: gym.vector.VectorEnv, agent: Agent, arguments: argparse.Namespace
    ) -> None:
        self.envs = envs
        self.agent = agent
        self.arguments = arguments
        apart = [
            1 + arguments.episode * row // envs.num_envs for row in range(envs.num_envs)
        ]  # first episodes end one after the other,
        self.observation, _ = envs.reset(
            seed=arguments.seed, options={"episode_steps": apart}
        )  # so that rollouts have all parts of them
        self.ended = np.zeros(
            envs.num_envs, dtype=bool
        )  # rows whose episode ended with the last step
        self.errors: list[
            float
        ] = []  # of the tip's position [m], after each step of the last rollout

    @torch.no_grad()
    def next(self) -> Batch:
        given = self.arguments
        seen = []
        done = []
        self.errors = []
        for _ in range(given.rollout):
            observation = torch.as_tensor(self.observation)
            distribution = self.agent.distribution(observation)
            action = distribution.sample()
            log_probability = distribution.log_prob(action).sum(1)
            value = self.agent.value(observation)[:, 0]
            is_transition = (
                ~self.ended if given.autoreset == "next_step" else np.ones_like(self.ended)
            )
            self.observation, reward, terminated, truncated, info = self.envs.step(
                action.numpy().clip(-1.0, 1.0)
            )
            self.ended = terminated | truncated
            after = self.observation  # what the step led to, also where the next episode has begun
            if given.autoreset == "same_step" and self.ended.any():
                after = after.copy()
                after[self.ended] = np.stack(info["final_obs"][self.ended])
            follows = self.agent.value(torch.as_tensor(after))[:, 0] * torch.as_tensor(~terminated)
            seen.append((observation, action, log_probability, value))
            done.append(
                (
                    torch.as_tensor(reward, dtype=torch.float32),
                    follows,
                    torch.as_tensor(self.ended),
                    torch.as_tensor(is_transition),
                )
            )
            self.errors.append(float(np.mean(info["position_error"])))
        return self.batch(seen, done)

    def batch(self, seen, done) -> Batch:
        """Generalised advantage estimation (Schulman et al. 2016), backwards; no sum goes beyond
        the end of an episode."""
        given = self.arguments
        advantage = torch.zeros(self.envs.num_envs)
        advantages = []
        for (_, _, _, value), (reward, follows, ended, _) in zip(
            reversed(seen), reversed(done), strict=True
        ):
            error = reward + given.gamma * follows - value
            advantage = error + given.gamma * given.gae_lambda * ~ended * advantage
            advantages.insert(0, advantage)
        observation, action, log_probability, value = (
            torch.stack(parts) for parts in zip(*seen, strict=True)
        )
        found = torch.stack(advantages)
        is_transition = torch.stack([step[3] for step in done])
        return Batch(
            *(
                each[is_transition]
                for each in (observation, action, log_probability, found, found + value)
            )
        )


def update(
    agent: Agent, optimizer: torch.optim.Optimizer, batch: Batch, given: argparse.Namespace
) -> float:
    """Epochs of the clipped objective of PPO (Schulman et al. 2017); the divergence from the policy
    before."""
    count = len(batch.action)
    divergence = 0.0
    for _ in range(given.epochs):
        for chosen in torch.randperm(count).split(given.batch):
            part = Batch(*(values[chosen] for values in batch))
            change = (
                agent.distribution(part.observation).log_prob(part.action).sum(1)
                - part.log_probability
            )
            ratio = change.exp()
            divergence = float(
                (ratio - 1.0 - change).detach().mean()
            )  # http://joschu.net/blog/kl-approx.html
            if divergence > 1.5 * given.target_kl:
                return divergence
            advantage = (part.advantage - part.advantage.mean()) / (
                part.advantage.std(correction=0) + 1e-8
            )
            gain = torch.min(
                ratio * advantage, ratio.clamp(1.0 - given.clip, 1.0 + given.clip) * advantage
            ).mean()
            loss = (agent.value(part.observation)[:, 0] - part.value_target).pow(2).mean()
            optimizer.zero_grad()
            (given.value_weight * loss - gain).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), given.greatest_gradient)
            optimizer.step()
    return divergence


def main() -> None:
    given = parse_arguments()
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)  # several are slower for networks as small
    options = {"fidelity": "fast", "difficulty": given.difficulty}
    drawn = {
        "latency": [0.0, 0.02]
    }  # for a margin of the loop: without it some arms begin to whirl
    learning = {
        "autoreset_mode": given.autoreset,
        "max_episode_steps": given.episode,
        "randomize": drawn,
    }
    envs = gym.make_vec(given.id, num_envs=given.rows, **learning, **options)
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimizer = torch.optim.Adam(agent.parameters(), lr=given.learning_rate, eps=1e-5)
    rollouts = Rollouts(envs, agent, given)
    updates = max(given.steps // (given.rows * given.rollout), 1)
    began = time.perf_counter()
    for number in range(1, updates + 1):
        optimizer.param_groups[0]["lr"] = given.learning_rate * (1.0 - 0.9 * (number - 1) / updates)
        divergence = update(agent, optimizer, rollouts.next(), given)
        if number % 10 == 0 or number == updates:
            steps = number * given.rows * given.rollout
            seconds = time.perf_counter() - began
            error = 1e3 * np.mean(rollouts.errors)
            print(
                f"{steps:8d} steps, {steps / seconds:6.0f} a second: mean error {error:6.1f} mm,"
                f" divergence {divergence:.3f}",
                flush=True,
            )
    envs.close()
    judges = gym.make_vec(given.id, num_envs=len(EVALUATION_SEEDS), **options)
    error = summarise(evaluate_rows(agent, judges, EVALUATION_SEEDS)).errors["position_error"]
    print(
        f"on the {len(EVALUATION_SEEDS)} episodes of evaluation: {1e3 * error.rms:.1f} mm root mean"
        " square"
    )


if __name__ == "__main__":
    main()
