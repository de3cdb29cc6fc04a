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
from soft_tendon_env.learning import callback, train
from soft_tendon_env.learning.config import read_training
from soft_tendon_env.policies.normalization import normalization_of, save_normalization
from soft_tendon_env.tools.messages import UserError

QUICK = ("--episodes", "1", "--seconds", "0.2", "--skip", "0.1")
NOMINAL = (*QUICK, "--errors", "nominal")
ARM = ("--scene", "three_tendon", "--fidelity", "fast")


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


def one_byte_is_another(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGES = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-20]),
    "empty": lambda path: path.write_bytes(b""),
    "garbage": lambda path: path.write_bytes(np.random.default_rng(0).bytes(5000)),
    "one byte": one_byte_is_another,
    "folder": lambda path: [path.unlink(), path.mkdir()],
    "missing": Path.unlink,
    "whole, of something else": lambda path: path.write_bytes(pickle.dumps(3) if path.suffix == ".pkl" else b"[]"),
}
SCRIPTS = {
    "train": ("last", ("model.zip", "vecnormalize.pkl"), ("{config}", "--resume", "--set", "steps=256", "--out", "{run}")),
    "evaluate": ("best", ("weights.pt", "statistics.npz"), ("{run}/best", "--episodes", "1", "--out", "{run}/out")),
    "record": ("best", ("weights.pt", "statistics.npz"), ("{run}/best", "--out", "{run}/out/a.rrd")),
}


@pytest.mark.parametrize("script", SCRIPTS)
@pytest.mark.cases("damage", DAMAGES)
@pytest.mark.cases("digests", [True, False])
def test_damaged_checkpoints_and_agents_are_refused(refused, config, copied, damage, digests, script):
    folder, names, arguments = SCRIPTS[script]
    for name in (*names, "config.json"):
        if damage == "one byte" and not (digests and name != "config.json"):
            continue  # without a digest, or in a text, a byte may be as good as another
        run = copied()
        if not digests:
            without_digests(run)
        DAMAGES[damage](run / folder / name)
        said = refused(script, *(argument.format(config=config, run=run) for argument in arguments))
        assert str(run / folder) in said and name in said


def test_files_of_two_trainings_are_not_taken_for_one(refused, run, small, tmp_path):
    """Each of them is whole."""
    path = run / "best" / "statistics.npz"
    statistics = normalization_of(VecNormalize(DummyVecEnv([lambda: gym.make(IDS["TipPose"], **small)])))
    save_normalization(path, statistics)
    said = refused("evaluate", run / "best", *NOMINAL, "--out", tmp_path)
    assert f"{path} is not the file that {path.with_name('config.json')} was written with" in said


def append(path, text):
    path.write_text(path.read_text() + text)


ON = ("--resume", "--set", "steps=256")


@pytest.mark.cases(
    "damage, arguments, said",
    [
        (lambda run: DAMAGES["cut"](run / "evaluations.csv"), ON, "evaluations.csv was cut off: its last line does not end"),
        (lambda run: DAMAGES["empty"](run / "evaluations.csv"), ON, "should have the columns steps, seconds, return, diverged"),
        (lambda run: DAMAGES["garbage"](run / "evaluations.csv"), ON, "evaluations.csv cannot be read as text"),
        (lambda run: shutil.copy(run / "config.json", run / "evaluations.csv"), ON, "should have the columns steps, seconds, return, dive"),
        (lambda run: append(run / "evaluations.csv", "256,oops\n"), ON, "evaluations.csv, line 4 should be 8 numbers, not '256,oops'"),
        (lambda run: DAMAGES["cut"](run / "best" / "config.json"), ON, "is no JSON, or was cut off"),
        (lambda run: (run / "best" / "config.json").write_text("{}"), ON, "best/config.json has no evaluation of the agent: take "),
        (lambda run: [shutil.rmtree(run / "last"), (run / "last").touch()], ON, "last/config.json cannot be read as text"),
        # not even where it came to no checkpoint: its best agent would be taken for one of this
        (lambda run: shutil.rmtree(run / "last"), ("--resume", "--set", "arms=8"), "has another training, arms was 4 and is 8: only "),
        (lambda run: (run / "config.json").unlink(), (), "has a training already: give --resume to go on with it, or another folder with"),
    ],
)
def test_folders_that_a_training_does_not_go_on_in(refused, config, copied, damage, arguments, said):
    run = copied()
    damage(run)
    found = refused("train", config, *arguments, "--out", run)
    assert said in found and str(run) in found


def test_resuming_from_nothing_is_said(command, config, tmp_path, capsys):
    for _ in range(2):  # a training that never came to a checkpoint has its configuration
        command("train", config, "--resume", "--out", tmp_path / "run")
        assert f"nothing to resume: {tmp_path / 'run'} has no checkpoint, the training begins at step 0" in capsys.readouterr().out
        shutil.rmtree(tmp_path / "run" / "last")


def test_an_agent_whose_weights_are_lost_replaces_no_checkpoint(config, run, tmp_path):
    training = read_training(config, ["steps=256"])
    before = (run / "last" / "model.zip").read_bytes()
    model, learning = train.model_of(training, run / "last"), callback.TrainingCallback(training, run, run / "last")
    with torch.no_grad():
        next(model.policy.parameters()).fill_(torch.nan)
    with pytest.raises(UserError, match="after 128 steps the agent's weights are no longer finite"):
        train.learn(model, learning)
    assert (run / "last" / "model.zip").read_bytes() == before


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), RuntimeError("PytorchStreamWriter failed")], ids=repr)
def test_a_disk_that_is_full_leaves_the_checkpoint_before(config, run, monkeypatch, error):
    training = read_training(config, ["steps=256"])
    before = {path: path.read_bytes() for path in (run / "last").iterdir()}
    model, learning = train.model_of(training, run / "last"), callback.TrainingCallback(training, run, run / "last")

    def fail(path):
        path.write_bytes(b"half of it")
        raise error

    monkeypatch.setattr(model, "save", fail)
    with pytest.raises(UserError, match="cannot be written: .*What stood there before, if anything, is as it was"):
        train.learn(model, learning)
    assert {path: path.read_bytes() for path in (run / "last").iterdir()} == before
    assert not list(run.glob("*.new")), "half a checkpoint does not fill the disk"


OUTS = {
    "train": ("{config}", "--out"),
    "sweep": ("{config}", "--seeds", "1", "--out"),
    "evaluate": ("feedforward", *ARM, *NOMINAL, "--out"),
    "compare": ("--task", "TipPose", "--policies", "feedforward", "--workers", "1", *ARM, *NOMINAL, "--out"),
    "demo": ("--agent", "{agent}", "--workers", "1", "--episodes", "1", "--seconds", "0.2", "--out"),
    "reproduce-paper": ("--figures", "2", "--seconds", "1", "--out"),
}


@pytest.mark.cases("place, reason", [("file", "File exists"), ("file/new", "Not a directory"), ("full", "No space left on device")])
@pytest.mark.parametrize("script", OUTS)
def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(
    refused, config, agent, small, monkeypatch, tmp_path, script, place, reason
):
    monkeypatch.setattr(demo, "ARM", small)
    monkeypatch.setattr(demo, "shipped_for", lambda task: ())  # agents of another arm
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir(exist_ok=True)
    arguments = [argument.format(config=config, agent=agent()) for argument in OUTS[script]]
    with monkeypatch.context() as patched:
        if place == "full":
            patched.setattr(errors.tempfile, "TemporaryFile", lambda dir: open("/dev/full", "wb"))
        said = refused(script, *arguments, tmp_path / place)
    assert said.startswith(f"soft-tendon {script}: error: --out is {tmp_path / place}: it should be a folder that can") and reason in said


def test_a_recording_that_cannot_be_written(refused, tmp_path):
    for path, reason in ((tmp_path, "Is a directory"), (Path("/dev/full"), "No space left on device")):
        said = refused("record", "feedforward", *ARM, *QUICK[2:], "--out", path)
        assert said.startswith(f"soft-tendon record: error: {path}") and reason in said


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


def test_folders_of_damaged_runs_are_named(refused, finished, tmp_path):
    runs = tmp_path / "runs"
    for seed in (0, 1):
        shutil.copytree(finished, runs / f"seed_{seed}")
    DAMAGES["cut"](runs / "seed_1" / "config.json")
    said = refused("compare", "--task", "TipPose", "--policies", runs, *NOMINAL, "--out", tmp_path / "out")
    assert f"{runs / 'seed_1' / 'config.json'} is no JSON, or was cut off" in said


@pytest.mark.cases("damage", ["cut", "empty", "garbage"])
@pytest.mark.cases("name", ["evaluations.csv", "config.json", "best/config.json"])
def test_a_damaged_run_is_left_out_of_the_curves(command, finished, tmp_path, monkeypatch, capsys, damage, name):
    shutil.rmtree(tmp_path / "runs", ignore_errors=True)
    for seed in (0, 1):
        shutil.copytree(finished, tmp_path / "runs" / "small" / f"seed_{seed}")
    DAMAGES[damage](tmp_path / "runs" / "small" / "seed_1" / name)
    monkeypatch.chdir(tmp_path)
    only_plot = ("sweep", "small.toml", "--only-plot", "--out", "runs")
    command(*only_plot)
    printed = capsys.readouterr().out
    assert re.search(rf"left out: runs/small/seed_1/{name} ", printed) and "| small " in printed
    DAMAGES[damage](tmp_path / "runs" / "small" / "seed_0" / name)
    with pytest.raises(SystemExit) as exit:
        command(*only_plot)
    assert exit.value.code == 1 and "not shown: runs/small has no run that was evaluated" in capsys.readouterr().out


def evaluated(command, capsys, path, *arguments):
    command("evaluate", path, *NOMINAL, *arguments)
    printed = capsys.readouterr()
    row = next(line for line in printed.out.splitlines() if line.startswith("| nominal "))
    return row.split("|")[2].strip(), [line for line in printed.err.splitlines() if line.startswith("note: ")]


def test_an_agent_of_others_without_what_belongs_to_it_is_refused_or_said_to_be(refused, command, run, tmp_path, capsys):
    """Stable-Baselines3's own file, which need have nothing beside it."""
    alone, out = tmp_path / "alone" / "model.zip", ("--out", tmp_path / "out")
    alone.parent.mkdir()
    whole, notes = evaluated(command, capsys, run / "last", *out)
    assert notes == []
    shutil.copy(run / "last" / "model.zip", alone)
    shutil.copy(run / "last" / "statistics.npz", alone.parent)
    said = refused("evaluate", alone, *NOMINAL, *out)
    assert "this environment has (93,)" in said, "of the default arm"
    same, notes = evaluated(command, capsys, alone, *ARM, *out)
    assert same == whole and len(notes) == 1
    assert notes[0].startswith(f"note: {alone}: no config.json says what it was trained on; numbers are right only if ")
    alone.with_name("statistics.npz").unlink()
    said = refused("evaluate", alone, *NOMINAL, *ARM, *out)
    assert f"{alone} should have its statistics.npz beside it: it sees observations through the statistics" in said
    assert "save_normalization of soft_tendon_env.policies.normalization writes them" in said


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
