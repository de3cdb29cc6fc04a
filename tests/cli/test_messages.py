"""Every command ends in one line where something is wrong: files that are cut, missing or of something else, folders, disks, workers."""

import errno
import json
import pickle
import re
import shutil
import tempfile
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from soft_tendon_env.cli import errors
from soft_tendon_env.demo import demo
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning import checkpoints, train
from soft_tendon_env.learning.config import read_training
from soft_tendon_env.policies.normalization import normalization_of, save_normalization
from soft_tendon_env.tools.messages import UserError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
TABLE = {
    "task": "TipPose",
    "algorithm": "PPO",
    "steps": 128,
    "arms": 4,
    "seconds": 0.4,
    "hyperparameters": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
    "options": SMALL,
    "normalise": {"observations": True},
    "evaluation": {"every": 128, "episodes": 2, "skip": 0.2},
    "checkpoint_every": 64,
}
QUICK = ("--episodes", "1", "--seconds", "0.2", "--skip", "0.1")
NOMINAL = (*QUICK, "--errors", "nominal")
ARM = ("--scene", "three_tendon", "--fidelity", "fast")


@pytest.fixture
def call(command, monkeypatch, capsys, tmp_path):
    """call("evaluate", *arguments): the exit status of a command in this process, and what it said in its last line."""
    monkeypatch.chdir(tmp_path)

    def run(script, *arguments):
        with pytest.raises(SystemExit) as exit:
            command(script, *arguments)
        printed = capsys.readouterr().err
        if isinstance(exit.value.code, str):
            return 1, exit.value.code
        return exit.value.code, printed.splitlines()[-1]

    return run


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    """The file of a small training."""
    import tomli_w

    path = tmp_path_factory.mktemp("configs") / "small.toml"
    path.write_text(tomli_w.dumps(TABLE))
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory, config):
    """The folder of a training that is done: look, but change copies only."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train.train(read_training(config), folder)
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """copied(): a new folder with a copy of a finished training."""
    return lambda: Path(shutil.copytree(finished, Path(tempfile.mkdtemp(dir=tmp_path)) / "run"))


@pytest.fixture
def run(copied):
    """A copy of a finished training."""
    return copied()


def without_digests(run):
    """As trainings were before their files had digests."""
    for path in run.glob("*/config.json"):
        config = json.loads(path.read_text())
        del config["files"]
        path.write_text(json.dumps(config))


def cut(path):
    path.write_bytes(path.read_bytes()[:-20])


def empty(path):
    path.write_bytes(b"")


def garbage(path):
    path.write_bytes(np.random.default_rng(0).bytes(5000))


def flipped(path):
    """One byte is another, in the numbers of a checkpoint."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def folder(path):
    path.unlink()
    path.mkdir()


def missing(path):
    path.unlink()


def other(path):
    """Whole, and of something else."""
    path.write_bytes(pickle.dumps(3) if path.suffix == ".pkl" else b"[]")


def damaged(*names):
    return [
        pytest.param(damage, name, digests, id=f"{damage.__name__}-{name}-{'digests' if digests else 'none'}")
        for damage in (cut, empty, garbage, flipped, folder, missing, other)
        for name in (*names, "config.json")
        for digests in (True, False)
        if damage is not flipped or (digests and name != "config.json")  # without a digest, or in a text, a byte may be as good as another
    ]


@pytest.mark.cases("damage, name, digests", damaged("model.zip", "vecnormalize.pkl"))
def test_a_damaged_checkpoint_is_not_gone_on_from(call, config, copied, damage, name, digests):
    run = copied()
    if not digests:
        without_digests(run)
    damage(run / "last" / name)
    status, said = call("train", config, "--resume", "--set", "steps=256", "--out", run)
    assert status == 2 and said.startswith("soft-tendon train: error: ") and str(run / "last") in said and name in said
    assert json.loads((run / "config.json").read_text())["steps"] == 128, "nothing was begun"


@pytest.mark.parametrize("script", ["evaluate", "record"])
@pytest.mark.cases("damage, name, digests", damaged("weights.pt", "statistics.npz"))
def test_a_damaged_agent_is_no_policy(call, copied, tmp_path, damage, name, digests, script):
    run = copied()
    if not digests:
        without_digests(run)
    damage(run / "best" / name)
    out = ("--out", tmp_path / "out" / "a.rrd") if script == "record" else (*QUICK[:2], "--out", tmp_path / "out")
    status, said = call(script, run / "best", *QUICK[2:], *out)
    assert status == 2 and said.startswith(f"soft-tendon {script}: error: ") and str(run / "best") in said and name in said
    assert not (tmp_path / "out").exists()


def test_files_of_two_trainings_are_not_taken_for_one(call, run, tmp_path):
    """Each of them is whole."""
    path = run / "best" / "statistics.npz"
    statistics = normalization_of(VecNormalize(DummyVecEnv([lambda: gym.make(IDS["TipPose"], **SMALL)])))
    save_normalization(path, statistics)
    status, said = call("evaluate", run / "best", *NOMINAL, "--out", tmp_path)
    assert status == 2 and f"{path} is not the file that {path.with_name('config.json')} was written with" in said


@pytest.mark.cases(
    "damage, said",
    [
        (lambda run: cut(run / "evaluations.csv"), "evaluations.csv was cut off: its last line does not end"),
        (lambda run: empty(run / "evaluations.csv"), "should have the columns steps, seconds, return, diverged"),
        (lambda run: garbage(run / "evaluations.csv"), "evaluations.csv cannot be read as text"),
        (lambda run: shutil.copy(run / "config.json", run / "evaluations.csv"), "should have the columns steps, seconds, return, diverged"),
        (lambda run: cut(run / "best" / "config.json"), "is no JSON, or was cut off"),
        (lambda run: (run / "best" / "config.json").write_text("{}"), "best/config.json has no evaluation of the agent: take "),
        (lambda run: [shutil.rmtree(run / "last"), (run / "last").touch()], "last/config.json cannot be read as text"),
    ],
)
def test_what_else_a_training_goes_on_from(call, config, copied, damage, said):
    run = copied()
    damage(run)
    status, found = call("train", config, "--resume", "--set", "steps=256", "--out", run)
    assert status == 2 and said in found and str(run) in found


def test_a_row_of_a_learning_curve_that_is_no_row(run):
    path = run / "evaluations.csv"
    path.write_text(path.read_text() + "256,oops\n")
    with pytest.raises(ValueError, match=r"evaluations.csv, line 4 should be \d+ numbers, not '256,oops'"):
        checkpoints.Evaluations(path, 256)


def test_resuming_from_nothing_is_said(command, config, tmp_path, capsys):
    for _ in range(2):  # a training that never came to a checkpoint has its configuration
        command("train", config, "--resume", "--out", tmp_path / "run")
        assert f"nothing to resume: {tmp_path / 'run'} has no checkpoint, the training begins at step 0" in capsys.readouterr().out
        shutil.rmtree(tmp_path / "run" / "last")


def test_another_training_does_not_begin_in_a_folder(call, config, run):
    """Not even where it came to no checkpoint: its best agent would be taken for one of this."""
    shutil.rmtree(run / "last")
    status, said = call("train", config, "--resume", "--set", "arms=8", "--out", run)
    assert status == 2 and "has another training, arms was 4 and is 8: only `steps`, " in said


def test_a_checkpoint_is_not_gone_on_from_unless_asked(call, config, run):
    (run / "config.json").unlink()
    status, said = call("train", config, "--out", run)
    assert status == 2 and said.endswith("has a training already: give --resume to go on with it, or another folder with --out")


def test_an_agent_whose_weights_are_lost_replaces_no_checkpoint(config, run, tmp_path):
    training = read_training(config, ["steps=256"])
    before = (run / "last" / "model.zip").read_bytes()
    model, learning = train.model_of(training, run / "last"), train.learning_of(training, run, run / "last")
    with torch.no_grad():
        next(model.policy.parameters()).fill_(torch.nan)
    with pytest.raises(UserError, match="after 128 steps the agent's weights are no longer finite"):
        train.learn(model, learning)
    assert (run / "last" / "model.zip").read_bytes() == before


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), RuntimeError("PytorchStreamWriter failed")], ids=repr)
def test_a_disk_that_is_full_leaves_the_checkpoint_before(config, run, monkeypatch, error):
    training = read_training(config, ["steps=256"])
    before = {path: path.read_bytes() for path in (run / "last").iterdir()}
    model, learning = train.model_of(training, run / "last"), train.learning_of(training, run, run / "last")

    def fail(path):
        path.write_bytes(b"half of it")
        raise error

    monkeypatch.setattr(model, "save", fail)
    with pytest.raises(UserError, match="cannot be written: .*What stood there before, if anything, is as it was"):
        train.learn(model, learning)
    assert {path: path.read_bytes() for path in (run / "last").iterdir()} == before
    assert not list(run.glob("*.new")), "half a checkpoint does not fill the disk"


STAGE = "curriculum=[{{{{start=9, options={{{{{}}}}}}}}}]"
OUTS = {
    "train": ("{config}", "--out"),
    "sweep": ("{config}", "--seeds", "1", "--out"),
    "evaluate": ("feedforward", *ARM, *NOMINAL, "--out"),
    "compare": ("--task", "TipPose", "--policies", "feedforward", "--workers", "1", *ARM, *NOMINAL, "--out"),
    "demo": ("--agent", "{agent}", "--workers", "1", "--episodes", "1", "--seconds", "0.2", "--out"),
    "reproduce-paper": ("--figures", "2", "--seconds", "1", "--out"),
}


@pytest.mark.parametrize("place", ["a file", "below a file", "full"])
@pytest.mark.parametrize("script", OUTS)
def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(call, config, agent, monkeypatch, tmp_path, script, place):
    monkeypatch.setattr(demo, "ARM", SMALL)
    (tmp_path / "file").touch()
    out = {"a file": tmp_path / "file", "below a file": tmp_path / "file" / "new", "full": tmp_path / "full"}[place]
    if place == "full":
        monkeypatch.setattr(errors.tempfile, "TemporaryFile", lambda dir: open("/dev/full", "wb"))
    arguments = [argument.format(config=config, agent=agent()) for argument in OUTS[script]]
    status, said = call(script, *arguments, out)
    reason = {"a file": "File exists", "below a file": "Not a directory", "full": "No space left on device"}[place]
    assert status == 2 and reason in said
    assert said.startswith(f"soft-tendon {script}: error: --out is {out}: it should be a folder that can be written")


def test_a_recording_that_cannot_be_written(call, tmp_path):
    for path, reason in ((tmp_path, "Is a directory"), (Path("/dev/full"), "No space left on device")):
        status, said = call("record", "feedforward", *ARM, *QUICK[2:], "--out", path)
        assert status == 2 and said.startswith(f"soft-tendon record: error: {path}") and reason in said


@pytest.mark.parametrize(
    "error, status, said",
    [
        (OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 1, "a.py: error: out/a.png: No space left on device"),
        (MemoryError("Unable to allocate 70 TiB"), 1, "a.py: error: there is too little memory: Unable to allocate 70 TiB"),
        (BrokenProcessPool("died"), 1, "a.py: error: a process of --workers was killed: it may have had too little memory"),
        (KeyboardInterrupt(), 130, "stopped: begin again"),
    ],
    ids=["disk", "memory", "worker", "Ctrl-C"],
)
def test_what_ends_a_script_is_said_in_one_line(capsys, error, status, said):
    with pytest.raises(SystemExit) as exit, errors.exit_in_one_line("a.py", "stopped: begin again"):
        raise error
    code = exit.value.code
    assert (code == status) if isinstance(code, int) else status == 1
    assert (code if isinstance(code, str) else capsys.readouterr().err.strip()).startswith(said)


def test_what_is_wrong_with_a_script_is_not_hidden():
    with pytest.raises(ValueError, match="a mistake of ours"), errors.exit_in_one_line("a.py", "stopped"):
        raise ValueError("a mistake of ours")


@pytest.mark.cases(
    "script, arguments, said",
    [
        ("train", ("{config}", "--set", "options.scene=nowhere"), "options.scene cannot be used: 'nowhere': is neither the path"),
        ("train", ("{config}", "--set", "options.scene=none.toml"), "options.scene cannot be used: none.toml: cannot be read"),
        ("train", ("{config}", "--set", STAGE.format("scene='nowhere'")), "curriculum[0].options.scene cannot be used"),
        ("train", ("{config}", "--set", STAGE.format("action='increment'")), "a stage cannot change it"),
        ("train", ("{config}", "--set", STAGE.format("scene='paper'")), "from step 9 on, observations are coordinates"),
        ("train", ("{config}", "--set", "residual={{controller='nope'}}"), "residual.controller is 'nope': valid: feedforward"),
        ("train", ("{config}", "--set", "seconds=1e12"), "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s"),
        ("train", ("{config}", "--set", "seconds=1e-9"), "seconds is 1e-09: it should be at least one control period, 0.02 s"),
        ("train", ("{config}", "--set", "evaluation.skip=5"), "it should be at least one control period, 0.02 s, and skip, which is 5"),
        ("train", ("{config}", "--set", "options.control_period=1e-9"), "it should be at most 1000000 control periods, 0.001 s"),
        ("train", ("{config}", "--set", "arms=1000000000"), "arms is 1000000000: it should be less than or equal to 100000"),
        ("train", ("{config}", "--set", "threads=100000"), "threads is 100000: it should be less than or equal to 256"),
        ("train", ("{config}", "--set", "seed=4294967296"), "seed is 4294967296: it should be less than 4294967296"),
        ("train", ("{config}", "--set", "learning_rate=[1, -1]"), "learning_rate is [1, -1]: it should be a number above 0 and at most"),
        ("train", ("{config}", "--set", "hyperparameters.n_steps.x=3"), "small.toml, changed: hyperparameters.n_steps.x cannot be set"),
        ("train", ("{config}", "--set", "arms=2", "steps=300", "arms=3"), "--set has arms, which is given twice"),
        ("train", ("{config}", "--seed", "3", "--set", "seed=4"), "--set has seed, which is given twice"),
        ("train", ("{config}", "--set", "arms=2", "--set", "arms=3"), "--set has arms, which is given twice"),
        ("train", ("{config}", "--set", "arms=1000000000", "--set", "steps=300"), "arms is 1000000000: it should be less than"),
        ("train", ("{config}", "--seed", "3", "--seed", "4"), "--seed is given twice, with 3 and 4"),
        ("evaluate", ("{best}", "--fidelity", "fast", "--fidelity", "fine"), "--fidelity is given twice, with fast and fine"),
        ("evaluate", ("{best}", "--errors", "nois", "--errors", "nominal"), "did you mean 'noise'"),
        ("evaluate", ("{best}", "--target", "circle", "--options", '{{"target": "hold"}}'), "--options has target, and so has --target"),
        ("train", ("none.toml",), "none.toml: cannot be read: No such file or directory"),
        ("train", ("{model}",), "model.zip: is not valid TOML"),
        ("sweep", ("{config}", "--set", "hyperparameters.n_steps=-5"), "hyperparameters.n_steps is -5: it should be greater than or"),
        ("sweep", ("{config}", "--set", "seed=3"), "--set has seed: --seeds and --first-seed say which there are"),
        ("sweep", ("{config}", "--seeds", "1000000000"), "--seeds is 1000000000: that makes more than 10000 runs"),
        ("sweep", ("{config}", "--write-docs", "none.md"), "there is no file none.md"),
        ("evaluate", ("{best}", "--seconds", "1e12"), "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s"),
        ("evaluate", ("{best}", "--options", '{{"action": "increment"}}'), "trained with action = 'tension', this environment has"),
        ("evaluate", ("{best}", "--options", '{{"preview": [0.2, 0.4]}}'), "was trained with preview = [0.1, 0.2], this environment has"),
        ("evaluate", ("SAC:{model}",), "the file is of PPO, not of SAC"),
        ("evaluate", ("A2C:{model}",), "the file is of PPO, not of A2C"),
        ("evaluate", ("{folder}",), "a folder: it should be the folder of an agent, such as {best}, a .zip file"),
        ("evaluate", ("measured:",), "policy is 'measured:', no policy: it should be the folder of an agent, a .zip file of"),
        ("compare", ("--policies", "{config}"), "has no folders seed_0, seed_1, ... of runs"),
        ("compare", ("--config", "{model}"), "model.zip: is not valid TOML"),
    ],
)
def test_mistakes_are_named(call, config, finished, tmp_path, script, arguments, said):
    known = {"config": config, "folder": finished, "best": finished / "best", "model": finished / "last" / "model.zip"}
    out = tmp_path / "out"
    status, found = call(script, *(argument.format(**known) for argument in arguments), "--out", out)
    assert status == 2 and found.startswith(f"soft-tendon {script}: error: ") and said.format(**known) in found
    assert not out.exists()


def test_folders_of_damaged_runs_are_named(call, finished, tmp_path):
    runs = tmp_path / "runs"
    for seed in (0, 1):
        shutil.copytree(finished, runs / f"seed_{seed}")
    cut(runs / "seed_1" / "config.json")
    status, said = call("compare", "--task", "TipPose", "--policies", runs, *NOMINAL, "--out", tmp_path / "out")
    assert status == 2 and f"{runs / 'seed_1' / 'config.json'} is no JSON, or was cut off" in said


@pytest.mark.parametrize("damage", [cut, empty, garbage])
@pytest.mark.parametrize("name", ["evaluations.csv", "config.json", "best/config.json"])
def test_a_damaged_run_is_left_out_of_the_curves(command, finished, tmp_path, monkeypatch, capsys, damage, name):
    for seed in (0, 1):
        shutil.copytree(finished, tmp_path / "runs" / "small" / f"seed_{seed}")
    damage(tmp_path / "runs" / "small" / "seed_1" / name)
    monkeypatch.chdir(tmp_path)
    only_plot = ("sweep", "small.toml", "--only-plot", "--out", "runs")
    command(*only_plot)
    printed = capsys.readouterr().out
    assert re.search(rf"left out: runs/small/seed_1/{name} ", printed) and "| small " in printed
    damage(tmp_path / "runs" / "small" / "seed_0" / name)
    with pytest.raises(SystemExit) as exit:
        command(*only_plot)
    assert exit.value.code == 1 and "not shown: runs/small has no run that was evaluated" in capsys.readouterr().out


def evaluated(command, capsys, path, *arguments):
    command("evaluate", path, *NOMINAL, *arguments)
    printed = capsys.readouterr()
    row = next(line for line in printed.out.splitlines() if line.startswith("| nominal "))
    return row.split("|")[2].strip(), [line for line in printed.err.splitlines() if line.startswith("note: ")]


def test_an_agent_of_others_without_what_belongs_to_it_is_refused_or_said_to_be(call, command, run, tmp_path, capsys):
    """Stable-Baselines3's own file, which need have nothing beside it."""
    alone, out = tmp_path / "alone" / "model.zip", ("--out", tmp_path / "out")
    alone.parent.mkdir()
    whole, notes = evaluated(command, capsys, run / "last", *out)
    assert notes == []
    shutil.copy(run / "last" / "model.zip", alone)
    shutil.copy(run / "last" / "statistics.npz", alone.parent)
    status, said = call("evaluate", alone, *NOMINAL, *out)
    assert status == 2 and "this environment has (93,)" in said, "of the default arm"
    same, notes = evaluated(command, capsys, alone, *ARM, *out)
    assert same == whole and len(notes) == 1
    assert notes[0].startswith(f"note: {alone}: no config.json says what it was trained on; numbers are right only if ")
    alone.with_name("statistics.npz").rename(alone.with_name("vecnormalize.pkl"))
    status, said = call("evaluate", alone, *NOMINAL, *ARM, *out)
    assert status == 2 and f"{alone} should have its statistics.npz beside it: it sees observations through the statistics" in said
    assert f"python -m soft_tendon_env.policies.convert {alone.parent}" in said, "what to do about vecnormalize.pkl"


def test_what_an_agent_is_judged_without_is_said(command, run, tmp_path, capsys):
    path = run / "best" / "config.json"
    config = json.loads(path.read_text())
    config["options"] |= {"randomize": {"payload": [0.0, 0.1]}, "reward": {"position": 1.0}}
    path.write_text(json.dumps(config))
    agent = path.parent
    _, notes = evaluated(command, capsys, agent, "--options", '{"control_period": 0.04}', "--out", tmp_path)
    assert notes == [
        f"note: {agent}: trained with control_period = 0.02, judged with 0.04",
        f"note: {agent}: judged without the randomize, reward of the training",
    ]
