"""Description of an agent's training from its config.json alone: imitation, reinforcement learning, and how much of each."""

import math
from collections.abc import Iterable

from soft_tendon_env.policies.agent_files import AGENT, AgentConfig, is_shipped, shipped_as
from soft_tendon_env.policies.names import Agent


def trained_by(name: str, task: str) -> str:
    """Description of an agent's training, "imitation of tracking (DAgger, 128,000 expert labels)". Raises ValueError, OSError."""
    agent = Agent(name, task)
    return words(agent.config, agent.algorithm)


def shipped_notes(policies: Iterable[str], task: str) -> list[str]:
    """Lines on those policies that are agents which ship for a task, "agent is dagger: imitation of ...". Raises ValueError, OSError."""
    shipped = [name for name in policies if is_shipped(name)]
    return [f"{f'{name} is ' if name == AGENT else ''}{shipped_as(name, task)}: {trained_by(name, task)}" for name in shipped]


def words(config: AgentConfig, algorithm: str) -> str:
    """Description of a training by its configuration and the algorithm of the network."""
    before = "" if config.start_from is None else f"from the agent {config.start_from}, then "
    if algorithm != "DAgger":
        return before + _learning(config, algorithm)
    labels = "" if config.steps_done is None else f", {config.steps_done:,} expert labels"
    return f"{before}imitation of tracking (DAgger{labels})"


def _learning(config: AgentConfig, algorithm: str) -> str:
    """Description of reinforcement learning."""
    if config.steps_done is None:
        return f"{algorithm} for a number of steps that is not known"
    count = _gradient_steps(config)
    notes = [] if count is None else [f"at most {count:,} gradient step{'s' if count != 1 else ''}"]
    return f"{algorithm} for {config.steps_done:,} steps" + (f" ({', '.join(notes)})" if notes else "")


def _gradient_steps(config: AgentConfig) -> int | None:
    """Number of gradient steps of all rollouts, unless target_kl ends them earlier; None where rollouts or batches are not known."""
    n_steps, batch, epochs = (config.hyperparameters.get(key) for key in ("n_steps", "batch_size", "n_epochs"))
    sizes = (config.arms, config.steps_done, n_steps, batch, epochs)
    if not all(isinstance(size, int) for size in sizes) or not (config.arms and n_steps and batch):
        return None
    rollout = config.arms * n_steps
    return (config.steps_done or 0) // rollout * math.ceil(rollout / batch) * epochs
