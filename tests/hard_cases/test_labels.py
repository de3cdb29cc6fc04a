"""What is said of how agents were trained: a file that names an algorithm says nothing of how little it did."""

from soft_tendon_env.policies.agent_files import AgentConfig
from soft_tendon_env.policies.trained_by import words

ROLLOUTS = {"n_steps": 16, "batch_size": 200, "n_epochs": 3}
ALGORITHMS = [
    ({}, "PPO for a number of steps that is not known"),
    ({"steps_done": 2560, "arms": 20, "hyperparameters": ROLLOUTS}, "PPO for 2,560 steps (at most 48 gradient steps)"),
    ({"algorithm": "DAgger", "steps_done": 9000}, "imitation of tracking (DAgger, 9,000 expert labels)"),
    ({"steps_done": 16, "arms": 1, "hyperparameters": {**ROLLOUTS, "n_epochs": 1}}, "PPO for 16 steps (at most 1 gradient step)"),
    ({"start_from": "runs/first", "steps_done": 7}, "from the agent runs/first, then PPO for 7 steps"),
]


def test_how_an_agent_was_trained():
    """Reinforcement learning without a known number of steps, with a single gradient step, from another agent; imitation.
    Expected: every part is named, with its number of steps, from the configuration alone.
    """
    assert [words(AgentConfig(**config), config.get("algorithm", "PPO")) for config, _ in ALGORITHMS] == [said for _, said in ALGORITHMS]
