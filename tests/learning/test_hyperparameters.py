"""Hyperparameters that no training can have are named, with their range, before anything is made of them."""

import pytest

from soft_tendon_env.learning import config, train
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
PPO = {"algorithm": "PPO", "task": "TipPose", "steps": 1000, "arms": 4, "seconds": 0.4, "options": SMALL, "evaluation": {"skip": 0.2}}
SAC = {**PPO, "algorithm": "SAC", "hyperparameters": {"buffer_size": 1000}}
TQC = {**SAC, "algorithm": "TQC"}
CROSSQ = {**SAC, "algorithm": "CrossQ"}
REACH = {**SAC, "task": "Reach"}
HINDSIGHT = {**REACH, "hindsight": {}, "hyperparameters": {"buffer_size": 1000, "learning_starts": 80}}
NETWORK = "hyperparameters.policy_kwargs.net_arch"
LAYERS = "it should be the sizes of layers, 1 to 16384, such as [128, 128], or { pi = [...], "
NUMBER = "it should be a valid number"


@pytest.fixture
def problems():
    """problems(table, **hyperparameters): the lines of the error."""

    def read(table, **hyperparameters):
        changed = {**table, "hyperparameters": {**table.get("hyperparameters", {}), **hyperparameters}}
        with pytest.raises(ConfigurationError) as error:
            config.Training.parse(changed, "file")
        return str(error.value).splitlines()

    return read


@pytest.mark.cases(
    "table, name, value, said",
    [
        (PPO, "n_steps", -5, "it should be greater than or equal to 1"),
        (PPO, "n_steps", 0, "it should be greater than or equal to 1"),
        (PPO, "n_steps", 2.5, "it should be a valid integer"),
        (PPO, "n_steps", True, "it should be a valid integer"),
        (PPO, "n_steps", 10**11, "it should be less than or equal to 100000000"),
        (PPO, "n_steps", float("nan"), "it should be a valid integer"),
        (PPO, "batch_size", 1, "it should be at least 2, or normalize_advantage = false"),
        (PPO, "n_epochs", 0, "it should be greater than or equal to 1"),
        (PPO, "gamma", 2.0, "it should be less than or equal to 1"),
        (PPO, "gamma", float("nan"), "it should be a finite number"),
        (PPO, "gae_lambda", -0.1, "it should be greater than or equal to 0"),
        (PPO, "clip_range", "lin_0.2", NUMBER),
        (PPO, "clip_range", 0, "it should be greater than 0"),
        (PPO, "clip_range_vf", -1, "it should be greater than 0"),
        (PPO, "ent_coef", "auto", NUMBER),
        (PPO, "max_grad_norm", 0.0, "it should be greater than 0"),
        (PPO, "target_kl", float("inf"), "it should be a finite number"),
        (PPO, "use_sde", "yes", "it should be a valid boolean"),
        (PPO, "sde_sample_freq", -7, "it should be at least 1, or -1"),
        (PPO, "stats_window_size", -1, "it should be greater than or equal to 1"),
        (SAC, "buffer_size", 2, "it should be at least one step of each arm, 4"),
        (SAC, "learning_starts", -1, "it should be greater than or equal to 0"),
        (SAC, "learning_starts", 1000, "it should be less than steps, 1000, or nothing is learned"),
        (SAC, "tau", 0, "it should be greater than 0"),
        (SAC, "train_freq", [1, "episode"], "it should be a valid integer"),
        (SAC, "gradient_steps", 0, "it should be at least 1, or -1"),
        (SAC, "ent_coef", "auto_0", 'it should be a number of at least 0, "auto", or "auto_" and a number to begin with'),
        (SAC, "ent_coef", "aut", 'it should be a number of at least 0, "auto", or "auto_" and a number to begin with'),
        (SAC, "target_entropy", "x", 'it should be a number or "auto"'),
        (SAC, "target_update_interval", 0, "it should be greater than or equal to 1"),
        (TQC, "top_quantiles_to_drop_per_net", 25, "it should be less than n_quantiles, 25"),
        (CROSSQ, "policy_delay", 0, "it should be greater than or equal to 1"),
        (REACH, "n_steps", 3, "it should be 1 on a task with goals"),
        (HINDSIGHT, "learning_starts", 10, "it should be at least 76, for episodes to have ended"),
        (HINDSIGHT, "buffer_size", 40, "it should be at least an episode of each arm, 80"),
    ],
)
def test_numbers_that_stable_baselines3_does_not_check(problems, table, name, value, said):
    (line,) = problems(table, **{name: value})
    assert line == f"file: hyperparameters.{name} is {value!r}: {said}"


@pytest.mark.cases("table, critic", [(PPO, "vf"), (SAC, "qf"), (TQC, "qf")])
@pytest.mark.cases("layers", [3, [-1], [0], ["a"], [1.5], "big", [10**9, 10**9], {"pi": [64]}, {"pi": [8], "af": [8]}])
def test_networks_that_cannot_be(problems, table, critic, layers):
    (line,) = problems(table, policy_kwargs={"net_arch": layers})
    assert line == f"file: {NETWORK} is {layers!r}: {LAYERS}{critic} = [...] }}"


@pytest.mark.cases(
    "policy, said",
    [
        (3, "policy_kwargs is 3: it should be a table"),
        ({"net_arc": [64]}, "policy_kwargs.net_arc is an unknown key (given [64]): did you mean 'net_arch'?"),
        ({"activation_fn": "Tahn"}, "it should be the name of an activation function in torch.nn: did you mean 'Tanh'?"),
        ({"activation_fn": "functional"}, "activation_fn is 'functional': it should be the name of an activation function"),
        ({"activation_fn": "GLU"}, "activation_fn is 'GLU': it should be the name of an activation function"),
        ({"log_std_init": 1e9}, "log_std_init is 1000000000.0: it should be less than or equal to 2"),
        ({"optimizer_class": "Adam"}, "policy_kwargs.optimizer_class is an unknown key (given 'Adam')"),
        ({"optimizer_kwargs": {"betas": [0.9, 1.0]}}, "optimizer_kwargs.betas[1] is 1.0: it should be less than 1"),
        ({"squash_output": True}, "hyperparameters.policy_kwargs.squash_output is True: it should be false unless use_sde is true"),
    ],
)
def test_policies_that_cannot_be(problems, policy, said):
    (line,) = problems(PPO, policy_kwargs=policy)
    assert said in line


def test_what_takes_objects_is_no_hyperparameter_of_a_file(problems):
    for table, name in ((PPO, "rollout_buffer_class"), (SAC, "action_noise"), (SAC, "optimize_memory_usage"), (PPO, "learning_rate")):
        (line,) = problems(table, **{name: 3})
        assert line.startswith(f"file: hyperparameters.{name} is an unknown key (given 3): ")


GOOD = {
    "PPO": (PPO, {"n_steps": 8, "batch_size": 16, "n_epochs": 1, "gamma": 0.9, "gae_lambda": 1, "clip_range_vf": 0.2, "target_kl": 0.1}),
    "one arm": ({**PPO, "arms": 1}, {"n_steps": 1, "batch_size": 1, "normalize_advantage": False}),
    "networks": (PPO, {"n_steps": 8, "batch_size": 16, "policy_kwargs": {"net_arch": {"pi": [8], "vf": []}, "activation_fn": "ELU"}}),
    "squashed": (PPO, {"n_steps": 8, "batch_size": 16, "use_sde": True, "policy_kwargs": {"squash_output": True, "full_std": False}}),
    "Adam": (PPO, {"n_steps": 8, "batch_size": 16, "policy_kwargs": {"optimizer_kwargs": {"betas": [0.8, 0.9], "weight_decay": 1e-4}}}),
    "SAC": (SAC, {"ent_coef": "auto_0.1", "target_entropy": -3, "policy_kwargs": {"net_arch": {"pi": [8], "qf": [9]}}}),
    "TQC": (TQC, {"top_quantiles_to_drop_per_net": 0, "ent_coef": 0.1, "policy_kwargs": {"n_quantiles": 2, "n_critics": 1}}),
    "CrossQ": (CROSSQ, {"policy_delay": 2, "policy_kwargs": {"batch_norm_momentum": 0.1, "renorm_warmup_steps": 10, "n_critics": 1}}),
    "HER": (HINDSIGHT, {"learning_starts": 76, "buffer_size": 80}),
}


@pytest.mark.cases("name", GOOD)
def test_what_is_in_range_makes_an_agent(name):
    table, hyperparameters = GOOD[name]
    training = config.Training.parse(
        {**table, "hyperparameters": {**table.get("hyperparameters", {}), **hyperparameters}}, "file"
    )
    assert train.make_model(training).num_timesteps == 0


def test_a_buffer_that_does_not_fit_into_the_machine(monkeypatch):
    training = config.Training.parse({**PPO, "hyperparameters": {"n_steps": 1000}}, "file")
    needed = 1000 * 4 * (54 + 3 + 6) * 4
    monkeypatch.setattr(train, "memory", lambda: needed)
    train.make_model(training)
    monkeypatch.setattr(train, "memory", lambda: needed - 1)
    with pytest.raises(ValueError, match="hyperparameters.n_steps is 1000, with 4 arms: that needs 0 GiB of memory, the machine has 0"):
        train.make_model(training)
