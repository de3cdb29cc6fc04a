"""Trainings as a user runs them: they learn, can be killed, repeated and resumed, and what they
leave can be used."""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pytest
import tomli_w

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import SEEDS, VALIDATION_SEEDS, evaluate, summarise
from soft_tendon_env.learning import checkpoints, config, monitor, train
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
OFF_POLICY = {"learning_starts": 60, "batch_size": 16, "gradient_steps": 1, "buffer_size": 1000}
SAC = {"algorithm": "SAC", "hyperparameters": OFF_POLICY, "normalise": {"rewards": False}}
RUNS = {
    "PPO": {},
    "SAC": SAC,
    "TQC": {"algorithm": "TQC", "hyperparameters": OFF_POLICY},
    "CrossQ": {"algorithm": "CrossQ", "hyperparameters": OFF_POLICY},
    "APG": {"algorithm": "APG", "hyperparameters": {"n_steps": 8, "averaged_updates": 4}},
    "DAgger": {
        "algorithm": "DAgger",
        "hyperparameters": {"rounds": 4, "n_epochs": 2, "batch_size": 16},
    },
    "RecurrentPPO": {
        "algorithm": "RecurrentPPO",
        "hyperparameters": {
            "n_steps": 16,
            "batch_size": 32,
            "n_epochs": 1,
            "policy_kwargs": {"lstm_hidden_size": 8},
        },
    },
    "running": {"task": "Reach", "normalise": {"observations": True}, "learning_rate": (1e-3, 0.0)},
}


def curve(folder):
    with open(folder / "evaluations.csv", newline="") as file:
        rows = []
        for cells in csv.DictReader(file):
            row = {name: float(value) for name, value in cells.items()}
            rows.append(row)
        return rows


@pytest.mark.usefixtures("recurrent_ppo")
@pytest.mark.parametrize(
    "run",
    [
        *("PPO", "APG", "RecurrentPPO", "running"),
        *(pytest.param(run, marks=pytest.mark.slow) for run in ("SAC", "TQC", "CrossQ", "DAgger")),
    ],
)
def test_every_algorithm_learns_is_saved_loaded_and_evaluated(training, tmp_path, run):
    chosen = training(**RUNS[run])
    train.train(chosen, tmp_path)
    rows = curve(tmp_path)
    assert [row["steps"] for row in rows] == [0, 128, 256]
    assert all(np.isfinite([*row.values()]).all() for row in rows)
    for name in ("best", "last"):
        files = {path.name for path in (tmp_path / name).iterdir()}
        assert {"weights.npz", "config.json"} <= files
        assert ("statistics.npz" in files) == chosen.normalise.observations
        assert ({"model.zip", "environment.pkl"} <= files) == (name == "last"), (
            "which a training goes on from"
        )
        assert ("replay_buffer.pkl" in files) == (
            name == "last" and chosen.algorithm not in ("APG", "PPO", "RecurrentPPO")
        ), "or what a teacher said"
        found = json.loads((tmp_path / name / "config.json").read_text())
        assert name == "last" or found["evaluated"]["steps"] == found["steps_done"]
        assert found["algorithm"] == chosen.algorithm
        assert found["record"]["versions"]["torch"]
    path = str(tmp_path / "last")
    options = policy_options(path, chosen.task, {})
    env = gym.make(IDS[chosen.task], max_episode_steps=20, **options)
    summary = summarise(
        evaluate(load_policy(path, env), env, VALIDATION_SEEDS[:2], chosen.evaluation.skip)
    )
    error = next(iter(summary.errors))
    assert summary.errors[error].rms == pytest.approx(rows[-1][f"{error}_rms"], rel=1e-3), (
        "as the learning curve says"
    )


def test_episodes_of_arms_do_not_all_begin_together(training):
    env = train.make_training_env(training(arms=10, seconds=0.4))
    env.reset()
    still = np.zeros((10, 3))
    ends = []
    for _ in range(60):
        _, _, has_ended, _ = env.step(still)
        ends.append(int(has_ended.sum()))
    assert ends[:20] == [1, 0] * 10, "one of ten every two of twenty steps"
    assert ends[20:] == ends[:20] * 2, "one of ten every two of twenty steps"


def test_arms_of_trainings_have_seeds_of_their_own_and_scales_of_the_environment(training):
    parts = [
        training(seed=seed).arm_seed(done)
        for seed in range(5)
        for done in (0, 1_000_000, 2_999_990)
    ]
    seeds = {first + arm for first in parts for arm in range(64)}
    assert len(seeds) == 64 * len(parts), "no two purposes share any"
    assert all(seed in SEEDS["training"] for seed in seeds), "no two purposes share any"
    model = train.make_model(training(seed=3))
    model.learn(64)
    plain = make_sb3_vec_env(IDS["TipPose"], 4, max_episode_steps=20, **SMALL)
    plain.seed(training(seed=3).arm_seed())
    np.testing.assert_array_equal(
        model.rollout_buffer.observations[::16], plain.reset()
    )  # row after row


@pytest.mark.usefixtures("recurrent_ppo")
@pytest.mark.parametrize(
    "run",
    [
        "PPO",
        *(
            pytest.param(run, marks=pytest.mark.slow)
            for run in ("RecurrentPPO", "SAC", "APG", "DAgger", "running")
        ),
    ],
)
def test_a_training_that_was_stopped_ends_as_one_that_was_not(training, tmp_path, run):
    """Stopped at an evaluation, it goes on from the checkpoint before: the same weights, bit for
    bit."""
    options = {**SMALL, "randomize": {"latency": [0.0, 0.03], "noise": {"position": 1e-3}}}
    evaluation = {"every": 64, "episodes": 1, "skip": 0.2}
    chosen = training(
        **{
            **RUNS[run],
            "steps": 192,
            "options": options,
            "learning_rate": (1e-3, 0.0),
            "evaluation": evaluation,
        }
    )

    def part(watch):
        return train.train(
            chosen,
            tmp_path / "parts",
            train.checkpoint_to_resume(tmp_path / "parts", chosen, resume=True),
            watch,
        )

    def stop(row):
        if row["steps"] >= 128:
            raise InterruptedError

    whole = train.train(chosen, tmp_path / "whole")
    with pytest.raises(InterruptedError):
        part(stop)
    found = part(None)
    weights = whole.policy.state_dict()
    found_weights = found.policy.state_dict()
    assert found_weights.keys() == weights.keys()
    for name, values in weights.items():
        assert bool((found_weights[name] == values).all()), name


@pytest.mark.slow
def test_a_killed_training_goes_on_from_its_last_checkpoint(table, tmp_path):
    path = tmp_path / "long.toml"
    path.write_text(tomli_w.dumps({**table, "steps": 10_000_000}))  # which no machine does
    out, command = (
        tmp_path / "run",
        [sys.executable, "-m", "soft_tendon_env", "train", path, "--out", tmp_path / "run"],
    )
    process = subprocess.Popen(
        command, env={**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}, stderr=subprocess.DEVNULL
    )
    try:
        while process.poll() is None and not (out / "last").exists():
            time.sleep(0.05)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    checkpoint = checkpoints.find_checkpoint(out / "last")
    done = checkpoints.read_checkpoint(checkpoint)["steps_done"]
    assert 64 <= done < 10_000_000
    more = config.read_training(path, [f"steps={done + 128}"])
    train.train(more, out, train.checkpoint_to_resume(out, more, resume=True))
    rows = [row["steps"] for row in curve(out)]
    assert rows == sorted(set(rows))
    assert rows[-1] == done + 128
    last = checkpoints.read_checkpoint(out / "last")
    assert last["steps_done"] == done + 128


@pytest.mark.slow
def test_other_trainings_and_versions_do_not_go_on(training, tmp_path):
    train.train(training(), tmp_path)
    more = training(steps=320)
    assert train.checkpoint_to_resume(tmp_path, more, resume=True) == tmp_path / "last"
    with pytest.raises(FileExistsError, match="--resume"):
        train.checkpoint_to_resume(tmp_path, more, resume=False)
    for changes, engine, said in (
        ({"arms": 8}, "sb3", "arms was 4 and is 8: only `steps` may"),
        ({}, "rllib", "engine was 'sb3' and is 'rllib'"),
    ):
        with pytest.raises(ValueError, match=said):
            train.checkpoint_to_resume(tmp_path, training(**changes), resume=True, engine=engine)
    path = tmp_path / "last" / "config.json"
    found = json.loads(path.read_text())
    found["record"]["versions"]["soft_tendon_env"] = "0.1.0"
    path.write_text(json.dumps(found))
    with pytest.raises(ValueError, match=r"another training, version was '0\.1\.0' and is "):
        train.checkpoint_to_resume(tmp_path, more, resume=True)


def test_a_training_begins_with_the_weights_of_an_agent(training, tmp_path):
    """Those that act, averaged weights too, until the first update; others are refused."""
    parent = train.make_model(training(seed=1, **RUNS["APG"]))
    record = checkpoints.config_record(training(**RUNS["APG"]), parent.rows.episodes)
    checkpoints.replace_checkpoint(
        tmp_path / "agent", record, lambda new: checkpoints.write_model(new, parent, False)
    )
    start = {**RUNS["APG"], "start_from": str(tmp_path / "agent")}
    child = train.make_model(training(seed=2, **start))
    for network in (child.policy, child.acting_policy):
        weights = network.state_dict()["action_net.weight"]
        assert (weights == parent.policy.action_net.weight).all()
    small = {"n_steps": 8, "policy_kwargs": {"net_arch": [16]}}
    with pytest.raises(ValueError, match="whose weights are of another network"):
        train.make_model(training(**{**start, "hyperparameters": small}))
    with pytest.raises(ValueError, match=r"start_from is .*: it should be an agent that observes"):
        train.make_model(training(options={**SMALL, "history": 2}, **start))


def test_the_best_agent_has_the_smallest_errors_or_the_greatest_return():
    rows = [
        {"return": 90.0, "cost": 0.05, "typical": 0.03},
        {"return": 91.0, "cost": 0.1, "typical": 0.35},
    ]
    assert min(rows, key=monitor.quality) is rows[0]
    assert min(rows, key=lambda row: monitor.quality(row, "return")) is rows[1]


@pytest.mark.slow
def test_the_best_agent_stays_the_best_when_the_training_goes_on(training, tmp_path):
    """Killed between the two renamings of a checkpoint, when the new one was complete."""
    assert monitor.quality({"cost": 0.05, "typical": 0.03}) < monitor.quality(
        {"cost": 0.1, "typical": 0.35}
    ), "though a few diverged"
    path = tmp_path / "best" / "config.json"
    train.train(training(), tmp_path)
    found = json.loads(path.read_text())
    assert monitor.quality(found["evaluated"]) == pytest.approx(
        min(map(monitor.quality, curve(tmp_path))), rel=1e-6
    )
    unbeatable = {**found, "evaluated": {**found["evaluated"], "cost": 1e-9}}
    path.write_text(json.dumps(unbeatable))
    more = training(steps=512)
    (tmp_path / "last").rename(tmp_path / "last.new")
    assert checkpoints.find_checkpoint(tmp_path / "last") is None, "killed while it was written"
    (tmp_path / "last.old").mkdir()
    train.train(more, tmp_path, train.checkpoint_to_resume(tmp_path, more, resume=True))
    assert json.loads(path.read_text()) == unbeatable
    assert curve(tmp_path)[-1]["steps"] == 512


def hyperparameters(**given):
    return {"hyperparameters": given}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"algorithm": "PPOO"}, "algorithm is 'PPOO'"),
        (
            {"options": {**SMALL, "observation": ["tip_postion"]}},
            "options.observation names 'tip_postion': did you mean 'tip_position'?",
        ),
        (
            {"options": {**SMALL, "sensors": [5.0]}},
            "options.sensors names 5: it should be at most the rod's length",
        ),
        (hyperparameters(gamma=2), "hyperparameters.gamma is 2: it should be a number from 0 to 1"),
        (
            hyperparameters(gama=0.9),
            "hyperparameters.gama is an unknown key (given 0.9): did you mean 'gamma'?",
        ),
        (
            {"learning_rate": "abc"},
            "learning_rate is 'abc': it should be a number such as 3e-4, [first, last], or [first,",
        ),
        (
            hyperparameters(learning_rate=0.1),
            "hyperparameters.learning_rate is an unknown key (given 0.1): ",
        ),
        (
            hyperparameters(rollout_buffer_class="Buffer"),
            "hyperparameters.rollout_buffer_class is an unknown key (given 'Buffer'): ",
        ),
        (
            hyperparameters(policy_kwargs=3),
            "hyperparameters.policy_kwargs is 3: it should be a table",
        ),
        (
            hyperparameters(policy_kwargs={"net_arc": [64]}),
            "hyperparameters.policy_kwargs.net_arc is an unknown key (given [64]): did you",
        ),
        ({"start_from": "apg"}, "start_from is 'apg': PPO would begin with a critic that knows"),
        (
            {"algorithm": "APG", **hyperparameters(gamma=0.9)},
            "hyperparameters.gamma is an unknown key",
        ),
    ],
)
def test_mistakes_in_a_file_are_named(training, changes, said):
    with pytest.raises(ConfigurationError) as error:
        training(**changes)
    assert str(error.value).startswith("file: ")
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            hyperparameters(n_steps=10**15),
            "PPO cannot be made of these hyperparameters: MemoryError, there is too little memory",
        ),
        (
            hyperparameters(policy_kwargs={"activation_fn": "Tahn"}),
            "activation_fn is 'Tahn': it should be the name of an activation",
        ),
        (
            hyperparameters(policy_kwargs={"squash_output": True}),
            "PPO cannot be made of these .*squash_output=True is only available",
        ),
        (
            {**RUNS["DAgger"], "normalise": {"observations": True}},
            "normalise.observations is true: DAgger has a scale of its own",
        ),
    ],
)
def test_what_the_algorithm_refuses_is_told(training, changes, said):
    with pytest.raises(ValueError, match=said):
        train.make_model(training(**changes))


def test_arguments_go_before_the_file(table, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(table))
    changes = [
        "options.scene=paper",
        "hyperparameters.gamma=0.9",
        "learning_rate=[1e-3, 0.0]",
        "steps=5_000",
    ]
    chosen = config.read_training(path, changes, seed=7)
    assert (
        chosen.options["scene"],
        chosen.hyperparameters["gamma"],
        chosen.steps,
        chosen.seed,
    ) == ("paper", 0.9, 5000, 7)
    assert [train.learning_rate(chosen)(remains) for remains in (1.0, 0.5, 0.0)] == pytest.approx(
        [1e-3, 5e-4, 0.0]
    )
    falls = chosen.model_copy(update={"learning_rate": (1e-3, 1e-5, "geometric")})
    assert [train.learning_rate(falls)(remains) for remains in (1.0, 0.5, 0.0)] == pytest.approx(
        [1e-3, 1e-4, 1e-5]
    )


@pytest.mark.parametrize(
    "path",
    [config.find_config(name) for name in config.config_names()],
    ids=lambda path: path.stem,
)
def test_shipped_configs_are_valid_and_named_by_what_they_are(path):
    chosen = config.read_training(path)
    assert {"TipPose": "tip_pose", "Shape": "shape", "Reach": "reach"}[chosen.task] in path.stem
    assert path.read_text().splitlines()[0].endswith(f"soft-tendon train {path.stem}")
    assert path.stem.startswith(chosen.algorithm.lower())
    assert not chosen.normalise.observations or chosen.options["tip_speed_limit"], (
        "or arms that whirl would change what all others see"
    )
