"""Hyperparameters are arguments of the algorithm and of its policy; others are named, and values that an algorithm refuses are told."""

import pytest

from soft_tendon_env.learning import callback, config, train
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.messages import UserError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
PPO = {"algorithm": "PPO", "task": "TipPose", "steps": 1000, "arms": 4, "seconds": 0.4, "options": SMALL, "evaluation": {"skip": 0.2}}
SAC = {**PPO, "algorithm": "SAC", "hyperparameters": {"buffer_size": 1000}}
HINDSIGHT = {**SAC, "task": "Reach", "hindsight": {}}


def parsed(table, **hyperparameters):
    return config.Training.parse({**table, "hyperparameters": {**table.get("hyperparameters", {}), **hyperparameters}}, "file")


@pytest.mark.cases(
    "table, name, value, said",
    [
        (PPO, "gama", 0.9, "gama is an unknown key (given 0.9): did you mean 'gamma'?"),
        (PPO, "buffer_size", 9, "buffer_size is an unknown key (given 9): valid: batch_size, "),
        (PPO, "rollout_buffer_class", "Buffer", "rollout_buffer_class is an unknown key (given 'Buffer'): "),
        (PPO, "learning_rate", 0.1, "learning_rate is an unknown key (given 0.1): "),
        (SAC, "action_noise", 0.1, "action_noise is an unknown key (given 0.1): "),
        (PPO, "policy_kwargs", 3, "policy_kwargs is 3: it should be a table"),
        (PPO, "policy_kwargs", {"net_arc": [64]}, "policy_kwargs.net_arc is an unknown key (given [64]): did you mean 'net_arch'?"),
        (SAC, "policy_kwargs", {"optimizer_class": "Adam"}, "policy_kwargs.optimizer_class is an unknown key (given 'Adam'): "),
    ],
)
def test_what_is_no_argument_is_named(table, name, value, said):
    with pytest.raises(ConfigurationError) as error:
        parsed(table, **{name: value})
    (line,) = str(error.value).splitlines()
    assert line.startswith(f"file: hyperparameters.{said}")


@pytest.mark.cases(
    "name, value, said",
    [
        ("batch_size", 1, "PPO cannot be made of these hyperparameters: .*batch"),
        ("n_steps", 10**15, "PPO cannot be made of these hyperparameters: MemoryError, there is too little memory"),
        ("policy_kwargs", {"activation_fn": "Tahn"}, "activation_fn is 'Tahn': it should be the name of an activation function"),
        ("policy_kwargs", {"squash_output": True}, "PPO cannot be made of these hyperparameters: .*squash_output=True is only available"),
    ],
)
def test_what_the_algorithm_refuses_is_told(name, value, said):
    with pytest.raises(ValueError, match=said):
        train.make_model(parsed(PPO, **{name: value}))


@pytest.mark.cases(
    "table, hyperparameters, said",
    [
        (PPO, {"gamma": "x"}, "PPO cannot learn with these hyperparameters: .*multiply.* \\(vec_normalize.py, line "),
        (PPO, {"n_epochs": "x"}, "PPO cannot learn with these hyperparameters: TypeError, .* \\(ppo.py, line "),
        (SAC, {"learning_starts": 4, "target_update_interval": 0}, "SAC cannot learn with these hyperparameters: ZeroDivisionError, "),
        (HINDSIGHT, {"learning_starts": 16, "buffer_size": 4}, "SAC cannot learn with .* Unable to sample before the end of the first"),
    ],
)
def test_what_ends_the_first_update_is_told(table, hyperparameters, said, tmp_path_factory):
    small = {"n_steps": 8, "batch_size": 16} if table is PPO else {}
    with pytest.raises(UserError, match=said):
        train.train(parsed({**table, "steps": 64}, **small, **hyperparameters), tmp_path_factory.mktemp("run"), None)


def test_errors_after_the_first_update_keep_their_traceback(monkeypatch, tmp_path):
    training = parsed({**PPO, "steps": 64}, n_steps=8, batch_size=16)
    model, learning = train.model_of(training, None), callback.TrainingCallback(training, tmp_path, None)
    model._n_updates = 1
    monkeypatch.setattr(model, "learn", lambda *_, **__: [].pop())
    with pytest.raises(IndexError):
        train.learn(model, learning)


def test_a_training_without_any_update_is_told(tmp_path, capsys):
    train.train(parsed({**SAC, "steps": 64}, learning_starts=100), tmp_path, None)
    assert "SAC has made no update: see learning_starts, gradient_steps and train_freq" in capsys.readouterr().err


@pytest.mark.cases(
    "options, said",
    [
        ({"observation": ["tip_position", "tip_postion"]}, "observation names 'tip_postion': did you mean 'tip_position'?"),
        ({"sensors": [5.0]}, "sensors names 5: it should be at most the rod's length"),
    ],
)
def test_options_that_do_not_fit_are_told_with_the_file(options, said):
    with pytest.raises(ConfigurationError) as error:
        parsed({**PPO, "options": {**SMALL, **options}})
    assert str(error.value).startswith(f"file: options.{said}")


GOOD = {
    "networks": (PPO, {"n_steps": 8, "batch_size": 16, "policy_kwargs": {"net_arch": {"pi": [8], "vf": []}, "activation_fn": "ELU"}}),
    "squashed": (PPO, {"n_steps": 8, "batch_size": 16, "use_sde": True, "policy_kwargs": {"squash_output": True, "full_std": False}}),
    "Adam": (PPO, {"n_steps": 8, "batch_size": 16, "policy_kwargs": {"optimizer_kwargs": {"betas": [0.8, 0.9], "weight_decay": 1e-4}}}),
    "SAC": (SAC, {"ent_coef": "auto_0.1", "target_entropy": -3, "policy_kwargs": {"net_arch": {"pi": [8], "qf": [9]}}}),
    "TQC": ({**SAC, "algorithm": "TQC"}, {"ent_coef": 0.1, "policy_kwargs": {"n_quantiles": 2, "n_critics": 1}}),
    "CrossQ": ({**SAC, "algorithm": "CrossQ"}, {"policy_delay": 2, "policy_kwargs": {"batch_norm_momentum": 0.1, "n_critics": 1}}),
    "HER": (HINDSIGHT, {"learning_starts": 76, "buffer_size": 80}),
}


@pytest.mark.cases("name", GOOD)
def test_arguments_make_an_agent(name):
    table, hyperparameters = GOOD[name]
    assert train.make_model(parsed(table, **hyperparameters)).num_timesteps == 0
