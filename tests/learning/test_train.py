"""Trainings as a user runs them: they learn, can be killed, repeated and resumed, and what they leave can be used."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3
import yaml

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tasks import TASKS, register_task
from soft_tendon_env.envs.tracking import Reward
from soft_tendon_env.evaluation import SEEDS, VALIDATION_SEEDS, evaluate, summarise
from soft_tendon_env.learning import callback, checkpoints, config, monitor, train, training_env, validation
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.policies import load
from soft_tendon_env.tools.configuration import ConfigurationError

ROOT = Path(__file__).parent.parent.parent
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
PPO = {"n_steps": 16, "batch_size": 32, "n_epochs": 1}
OFF_POLICY = {"learning_starts": 60, "batch_size": 16, "gradient_steps": 1, "buffer_size": 1000}
TABLE = {
    "task": "TipPose",
    "algorithm": "PPO",
    "steps": 256,
    "arms": 4,
    "seconds": 0.4,
    "hyperparameters": PPO,
    "options": SMALL,
    "evaluation": {"every": 128, "episodes": 2, "skip": 0.2},
    "checkpoint_every": 64,
}
CONFIGS = [config.find_config(name) for name in config.config_names()]


@pytest.fixture
def training():
    """training(steps=..., ...): a small one, changed."""
    return lambda **changes: config.Training(**{**TABLE, **changes})


def curve(folder):
    with open(folder / "evaluations.csv", newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


RUNS = {
    "PPO": {},
    "SAC": {"algorithm": "SAC", "hyperparameters": OFF_POLICY, "normalise": {"rewards": False}},
    "TQC": {"algorithm": "TQC", "hyperparameters": OFF_POLICY},
    "CrossQ": {"algorithm": "CrossQ", "hyperparameters": OFF_POLICY},
    "APG": {"algorithm": "APG", "hyperparameters": {"n_steps": 8}},
    "Shape": {"task": "Shape", "options": {**SMALL, "action": "increment"}, "learning_rate": (1e-3, 0.0)},
    "DAgger": {"algorithm": "DAgger", "hyperparameters": {"rounds": 4, "n_epochs": 2, "batch_size": 16}},
    "hindsight": {"task": "Reach", "algorithm": "SAC", "hyperparameters": {**OFF_POLICY, "learning_starts": 100}, "hindsight": {}},
    "running": {"task": "Reach", "normalise": {"observations": True}},
}


@pytest.mark.parametrize("run", RUNS)
def test_every_algorithm_learns_is_saved_loaded_and_evaluated(tmp_path, training, run):
    chosen = training(**RUNS[run])
    train.train(chosen, tmp_path)
    rows = curve(tmp_path)
    assert [row["steps"] for row in rows] == [0, 128, 256]
    assert all(np.isfinite([*row.values()]).all() for row in rows)
    for name in ("best", "last"):
        files = {path.name for path in (tmp_path / name).iterdir()}
        assert {"weights.pt", "config.json"} <= files
        assert ("statistics.npz" in files) == chosen.normalise.observations
        assert ({"model.zip", "vecnormalize.pkl"} <= files) == (name == "last"), "which a training goes on from"
        assert ("replay_buffer.pkl" in files) == (name == "last" and chosen.algorithm not in ("APG", "PPO")), "or what a teacher said"
        config = json.loads((tmp_path / name / "config.json").read_text())
        assert name == "last" or config["evaluated"]["steps"] == config["steps_done"]
        assert config["algorithm"] == chosen.algorithm and config["seed"] == 0 and config["record"]["versions"]["torch"]
    steps = round(chosen.seconds / 0.02)
    path = str(tmp_path / "last")
    env = gym.make(IDS[chosen.task], max_episode_steps=steps, **load.policy_options(path, chosen.task, {}))
    summary = summarise(evaluate(load.load_policy(path, env), env, VALIDATION_SEEDS[:2], chosen.evaluation.skip))
    error = next(iter(summary.errors))
    assert summary.errors[error].rms == pytest.approx(rows[-1][f"{error}_rms"], rel=1e-3), "as the learning curve says"


def test_episodes_of_arms_do_not_all_begin_together(training):
    chosen = training(arms=10, seconds=0.4)
    env = training_env.make_training_env(chosen)
    env.reset()
    ends = [int(env.step(np.zeros((10, 3)))[2].sum()) for _ in range(60)]
    assert ends[:20] == [1, 0] * 10 and ends[20:] == ends[:20] * 2, "one of ten every two of twenty steps"


def test_arms_of_trainings_have_seeds_of_their_own(training, monkeypatch):
    parts = [training(seed=seed).arm_seed(done) for seed in range(5) for done in (0, 1_000_000, 2_999_990)]
    seeds = {first + arm for first in parts for arm in range(64)}
    assert len(seeds) == 64 * len(parts) and all(seed in SEEDS["training"] for seed in seeds), "no two purposes share any"

    given = []
    seeded = training_env.make_sb3_vec_env
    monkeypatch.setattr(training_env, "make_sb3_vec_env", lambda *args, **kwargs: spied(seeded(*args, **kwargs), given))
    train.make_model(training(seed=3))
    assert given[-1] == training(seed=3).arm_seed()


def spied(env, given):
    seed = env.seed
    env.seed = lambda value=None: (given.append(value), seed(value))[1]
    return env


def test_the_same_seed_gives_the_same_learning_curve(tmp_path, training):
    curves = {}
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        train.train(training(seed=seed), tmp_path / name)
        curves[name] = [{key: value for key, value in row.items() if key != "seconds"} for row in curve(tmp_path / name)]
    assert curves["a"] == curves["b"] != curves["c"]


@pytest.mark.parametrize("run", ["PPO", "SAC", "APG", "DAgger", "hindsight", "running"])
def test_a_training_that_was_stopped_ends_as_one_that_was_not(tmp_path, training, run):
    """Stopped at two evaluations, it goes on from the checkpoint before: the same weights, bit for bit."""
    options = {**RUNS[run].get("options", SMALL), "randomize": {"latency": [0.0, 0.03], "noise": {"position": 1e-3}}}
    evaluation = {"every": 64, "episodes": 1, "skip": 0.2}
    chosen = training(**{**RUNS[run], "options": options, "learning_rate": (1e-3, 0.0), "evaluation": evaluation})

    def part(watch):
        return train.train(chosen, tmp_path / "parts", train.checkpoint_to_resume(tmp_path / "parts", chosen, resume=True), watch)

    def stop(row):
        if row["steps"] >= 128:
            raise InterruptedError

    whole = train.train(chosen, tmp_path / "whole")
    for _ in range(2):
        with pytest.raises(InterruptedError):
            part(stop)
    found = part(None)
    weights = [model.policy.state_dict().values() for model in (whole, found)]
    assert all(bool((one == other).all()) for one, other in zip(*weights, strict=True))


def test_an_error_of_a_users_own_reward_is_none_of_hyperparameters(tmp_path, training, monkeypatch):
    whole, calls, closed = Reward.of, [], []

    def reward(*arguments):
        calls.append(0)
        if len(calls) > 30:
            raise ValueError("of my own")
        return whole(*arguments)

    monkeypatch.setattr(Reward, "of", reward)
    monkeypatch.setattr(monitor.tqdm, "close", lambda bar: closed.append(bar))
    with pytest.raises(ValueError, match="^of my own$"):
        train.train(training(), tmp_path)
    assert closed


def test_a_training_can_begin_with_the_network_of_an_agent(tmp_path, training):
    train.train(training(), tmp_path / "first")
    last = str(tmp_path / "first" / "last")
    train.train(training(start_from=last, seed=1), tmp_path / "second")
    begun, ended = curve(tmp_path / "second")[0], curve(tmp_path / "first")[-1]
    assert begun["steps"] == 0 and begun["position_error_rms"] == ended["position_error_rms"]
    assert ended["position_error_rms"] != curve(tmp_path / "first")[0]["position_error_rms"]
    for changes, said in (
        ({"hyperparameters": {**PPO, "policy_kwargs": {"net_arch": [8]}}}, "its network is not of the shape"),
        ({"options": {**SMALL, "action": "increment"}}, "action = 'tension', this environment has 'increment'"),
        ({"start_from": str(tmp_path)}, "weights.pt"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=said):
            train.model_of(training(**{"start_from": last, **changes}), None)


def write_table(path, table):
    import tomli_w

    path.write_text(tomli_w.dumps(table))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("when", [{}, {"checkpoint_every": 10**9, "checkpoint_seconds": 0.5}], ids=["steps", "time"])
def test_a_killed_training_goes_on_from_its_last_checkpoint(tmp_path, when):
    path = write_table(tmp_path / "long.toml", {**TABLE, "steps": 100_000, **when})
    out, command = tmp_path / "run", [sys.executable, "-m", "soft_tendon_env", "train", path, "--out", tmp_path / "run"]
    process = subprocess.Popen(command, env={**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + 240.0
        while time.monotonic() < until and process.poll() is None and not (out / "last").exists():
            time.sleep(0.05)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = checkpoints.read_checkpoint(checkpoints.find_checkpoint(out / "last"))["steps_done"]
    assert 64 <= done < 100_000
    steps = done + 128
    training = config.read_training(path, [f"steps={steps}"])
    train.train(training, out, train.checkpoint_to_resume(out, training, resume=True))
    rows = [row["steps"] for row in curve(out)]
    assert rows == sorted(set(rows)) and rows[-1] == steps == checkpoints.read_checkpoint(out / "last")["steps_done"]
    with pytest.raises(FileExistsError, match="--resume"):
        train.checkpoint_to_resume(out, training, resume=False)
    with pytest.raises(ValueError, match="arms was 4 and is 8: only `steps`, `checkpoint_every`, `checkpoint_seconds` may change"):
        train.checkpoint_to_resume(out, config.read_training(path, ["arms=8"]), resume=True)


def test_checkpoints_by_default_lose_a_minute_and_take_little_of_the_time(tmp_path, training, monkeypatch):
    """Ten seconds of a clock for every rollout; a checkpoint takes none, or so long that it would be more than a twentieth."""
    for name, cost, expected in (("quick", 0.0, [384, 768]), ("slow", 6.0, [384])):
        clock = [0.0]
        kept = []

        def save(folder, model, config, resumable, cost=cost, kept=kept, clock=clock):
            if resumable:
                clock[0] += cost
                kept.append(config["steps_done"])

        def now(clock=clock):
            return clock[0]

        monkeypatch.setattr(monitor.time, "perf_counter", now)
        monkeypatch.setattr(callback, "save_checkpoint", save)
        changes = {name: config.Training.model_fields[name].default for name in ("checkpoint_every", "checkpoint_seconds")}
        chosen = training(**changes, steps=896, evaluation={"every": 10_000, "episodes": 1, "skip": 0.2})
        model, learning = train.model_of(chosen, None), callback.TrainingCallback(chosen, tmp_path / name, None)
        (tmp_path / name).mkdir()
        begin = learning._on_rollout_start

        def rollout(begin=begin, clock=clock):
            begin()
            clock[0] += 10.0

        monkeypatch.setattr(learning, "_on_rollout_start", rollout)
        train.learn(model, learning)
        assert kept == [*expected, 896]


def test_a_training_of_before_goes_on_when_keys_came_later(tmp_path, training):
    train.train(training(), tmp_path)
    for path in (tmp_path / "config.json", tmp_path / "last" / "config.json"):
        found = json.loads(path.read_text())
        del found["checkpoint_seconds"], found["normalise"]["clip"]
        path.write_text(json.dumps(found))
    more = training(steps=320, checkpoint_every=10, checkpoint_seconds=5.0)
    assert train.checkpoint_to_resume(tmp_path, more, resume=True) == tmp_path / "last"
    with pytest.raises(ValueError, match="normalise was .*'observations': False.* and is .*'observations': True"):
        train.checkpoint_to_resume(tmp_path, training(normalise={"observations": True}), resume=True)
    found["record"]["versions"]["soft_tendon_env"] = "0.1.0"
    path.write_text(json.dumps(found))
    with pytest.raises(ValueError, match=r"last was written by soft_tendon_env 0\.1\.0, this is .*: only that version can go on with it"):
        train.train(more, tmp_path, tmp_path / "last")
    path.write_text(json.dumps({**found, "added_to": "tracking"}))
    with pytest.raises(ValueError, match="added_to is 'tracking': it is an unknown key"):
        train.checkpoint_to_resume(tmp_path, more, resume=True)


def test_observations_keep_the_scales_of_the_environment_unless_asked(training):
    model = train.make_model(training())
    model.learn(64)
    plain = make_sb3_vec_env(IDS["TipPose"], 4, max_episode_steps=20, **SMALL)
    plain.seed(training().arm_seed())
    first = model.rollout_buffer.observations[:: PPO["n_steps"]]  # row after row
    np.testing.assert_array_equal(first, plain.reset())


def test_the_best_agent_stays_the_best_when_the_training_goes_on(tmp_path, training):
    path = tmp_path / "best" / "config.json"
    train.train(training(), tmp_path)
    found = json.loads(path.read_text())
    quality = validation.quality
    assert quality(found["evaluated"]) == pytest.approx(min(map(quality, curve(tmp_path))), rel=1e-6)
    unbeatable = {**found, "evaluated": {**found["evaluated"], "position_error_rms": 1e-9}}
    path.write_text(json.dumps(unbeatable))
    more = training(steps=512)
    train.train(more, tmp_path, train.checkpoint_to_resume(tmp_path, more, resume=True))
    assert json.loads(path.read_text()) == unbeatable and curve(tmp_path)[-1]["steps"] == 512


def test_a_replay_buffer_is_kept_for_going_on(tmp_path, training):
    changes = RUNS["SAC"]
    train.train(training(**changes), tmp_path)
    more = training(**changes, steps=320)
    model = train.load_model(more, train.checkpoint_to_resume(tmp_path, more, resume=True))
    assert model.replay_buffer.size() * model.n_envs == 256 == model.num_timesteps


def test_a_users_own_task_with_goals_gets_the_policy_for_goals(tmp_path, training, forgotten):
    register_task(replace(TASKS["Reach"], name="Touch"))
    train.train(training(task="Touch", algorithm="SAC", hyperparameters={**OFF_POLICY, "learning_starts": 100}, hindsight={}), tmp_path)
    assert "position_error_rms" in curve(tmp_path)[-1]
    with pytest.raises(ConfigurationError, match="hindsight is for SAC, TQC and CrossQ on tasks with goals"):
        training(algorithm="SAC", hyperparameters=OFF_POLICY, hindsight={})


def test_of_two_checkpoints_the_complete_one_is_found(tmp_path):
    saved, last = checkpoints.find_checkpoint, tmp_path / "last"
    assert saved(last) is None
    (tmp_path / "last.new").mkdir()
    assert saved(last) is None, "killed while the first was written"
    (tmp_path / "last.old").mkdir()
    assert saved(last) == tmp_path / "last.new", "killed between the two renamings"
    last.mkdir()
    assert saved(last) == last, "killed while the next was written"


@pytest.mark.cases(
    "changes, said",
    [
        ({"algorithm": "PPOO"}, "algorithm is 'PPOO'"),
        ({"tasks": "Shape"}, "did you mean 'task'"),
        ({"hyperparameters": {"gama": 0.9}}, "hyperparameters.gama is an unknown key (given 0.9): did you mean 'gamma'"),
        ({"options": {"fidelity": "quick"}}, "options.fidelity is 'quick'"),
        ({"hindsight": {}}, "is for SAC, TQC and CrossQ on tasks with goals, such as Reach, not for PPO on TipPose"),
        ({"options": {"actions": "increment"}}, "options.actions is an unknown key"),
        ({"integral_time": 0.01}, "integral_time is 0.01: it should be at least a control period, 0.02 s"),
    ],
)
def test_mistakes_in_a_file_are_named(tmp_path, changes, said):
    path = write_table(tmp_path / "mine.toml", {**TABLE, **changes})
    with pytest.raises(ConfigurationError) as error:
        config.read_training(path)
    assert said in str(error.value) and str(error.value).startswith(str(path))


def test_arguments_go_before_the_file(tmp_path):
    path = write_table(tmp_path / "mine.toml", TABLE)
    changes = ["options.scene=paper", "hyperparameters.gamma=0.9", "learning_rate=[1e-3, 0.0]", "steps=5_000"]
    chosen = config.read_training(path, changes, seed=7)
    assert (chosen.options["scene"], chosen.hyperparameters["gamma"], chosen.steps, chosen.seed) == ("paper", 0.9, 5000, 7)
    rate = train.learning_rate(chosen)
    assert [rate(remains) for remains in (1.0, 0.5, 0.0)] == pytest.approx([1e-3, 5e-4, 0.0])
    with pytest.raises(ValueError, match="should be KEY=VALUE"):
        config.read_training(path, ["steps"])


@pytest.mark.cases("path", CONFIGS)
def test_shipped_configs_are_valid_and_named_by_what_they_are(path):
    chosen = config.read_training(path)
    task = {"TipPose": "tip_pose", "Shape": "shape", "Reach": "reach"}[chosen.task]
    assert task in path.stem and path.read_text().splitlines()[0].endswith(f"soft-tendon train {path.stem}")
    assert path.stem.startswith(chosen.algorithm.lower())
    assert set(tomllib.loads(path.read_text())) <= set(chosen.model_dump())
    assert not chosen.normalise.observations or chosen.options["tip_speed_limit"], "or arms that whirl would change what all others see"
    assert chosen.checkpoint_seconds <= 60.0


FILES = sorted((ROOT / "configs" / "rl_zoo3").glob("*.yml"))
ZOO = [(path.stem, id) for path in FILES for id in yaml.safe_load(path.read_text())]


@pytest.mark.cases("algorithm, id", ZOO)
def test_files_for_rl_zoo3_say_what_the_trainings_of_this_package_do(algorithm, id):
    """rl_zoo3 takes keys of its own out of a table, evaluates what is text, and gives the rest to the algorithm."""
    table = yaml.safe_load((ROOT / "configs" / "rl_zoo3" / f"{algorithm}.yml").read_text())[id]
    task = {name: task for task, name in IDS.items()}[id]
    same = config.read_training(ROOT / "configs" / f"{algorithm}_{ {'TipPose': 'tip_pose'}.get(task, task.lower()) }.toml")
    assert (table.pop("n_timesteps"), table.pop("n_envs")) == (same.steps, same.arms)
    normalised = eval(table.pop("normalize", "dict(norm_obs=False, norm_reward=False)"))
    assert normalised == {"norm_obs": same.normalise.observations, "norm_reward": same.normalise.rewards}
    rate = table.pop("learning_rate")
    if isinstance(same.learning_rate, float):
        assert rate == same.learning_rate
    else:
        assert rate.startswith("lin_") and float(rate.removeprefix("lin_")) == same.learning_rate[0]
    policy, table["policy_kwargs"] = table.pop("policy"), eval(table["policy_kwargs"])
    assert table == same.hyperparameters
    kind = train.training_class(same.algorithm)
    kind(policy, make_sb3_vec_env(id, 2, **SMALL), device="cpu", **{**table, **({"buffer_size": 100} if algorithm != "ppo" else {})})


def test_the_extra_has_what_the_progress_bar_of_stable_baselines3_needs(training):
    extra = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["agents"]
    assert any(needed.startswith("rich") for needed in extra)
    envs = make_sb3_vec_env(IDS["TipPose"], 4, **SMALL)
    stable_baselines3.PPO("MlpPolicy", envs, **PPO, device="cpu").learn(64, progress_bar=True)
