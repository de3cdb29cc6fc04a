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
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning import monitor, train
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
def test_damaged_checkpoints_and_agents_are_refused(refused, config, copied, damage, script):
    folder, names, arguments = SCRIPTS[script]
    for name in (*names, "config.json"):
        if damage == "one byte" and name == "config.json":
            continue  # in a text a byte may be as good as another
        run = copied()
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
        (lambda run: shutil.copy(run / "config.json", run / "evaluations.csv"), ON, "should have the columns steps, seconds, return, dive"),
        (lambda run: append(run / "evaluations.csv", "256,oops\n"), ON, "evaluations.csv, line 4 should be 8 numbers, not '256,oops'"),
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


def test_an_agent_whose_weights_are_lost_replaces_no_checkpoint(config, run, tmp_path):
    training = read_training(config, ["steps=256"])
    before = (run / "last" / "model.zip").read_bytes()
    model, learning = train.model_of(training, run / "last"), monitor.TrainingCallback(training, run, run / "last")
    with torch.no_grad():
        next(model.policy.parameters()).fill_(torch.nan)
    with pytest.raises(UserError, match="after 128 steps the agent's weights are no longer finite"):
        train.learn(model, learning)
    assert (run / "last" / "model.zip").read_bytes() == before


def test_a_disk_that_is_full_leaves_the_checkpoint_before(config, run, monkeypatch):
    training = read_training(config, ["steps=256"])
    before = {path: path.read_bytes() for path in (run / "last").iterdir()}
    model, learning = train.model_of(training, run / "last"), monitor.TrainingCallback(training, run, run / "last")

    def fail(path):
        path.write_bytes(b"half of it")
        raise RuntimeError("PytorchStreamWriter failed")

    monkeypatch.setattr(model, "save", fail)
    with pytest.raises(UserError, match="cannot be written: .*What stood there before, if anything, is as it was"):
        train.learn(model, learning)
    assert {path: path.read_bytes() for path in (run / "last").iterdir()} == before
    assert not list(run.glob("*.new")), "half a checkpoint does not fill the disk"


OUTS = {
    "train": ("{config}", "--out"),
    "evaluate": ("feedforward", *ARM, *NOMINAL, "--out"),
    "compare": ("--task", "TipPose", "--policies", "feedforward", "--workers", "1", *ARM, *NOMINAL, "--out"),
}


@pytest.mark.cases("place, reason", [("file", "File exists"), ("file/new", "Not a directory"), ("full", "No space left on device")])
@pytest.mark.cases("script", OUTS)
def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(refused, config, monkeypatch, tmp_path, script, place, reason):
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir(exist_ok=True)
    arguments = [argument.format(config=config) for argument in OUTS[script]]
    with monkeypatch.context() as patched:
        if place == "full":
            patched.setattr(errors.tempfile, "TemporaryFile", lambda dir: open("/dev/full", "wb"))
        said = refused(script, *arguments, tmp_path / place)
    assert said.startswith(f"soft-tendon {script}: error: --out is {tmp_path / place}: it should be a folder that can") and reason in said


def test_a_recording_that_cannot_be_written(refused, tmp_path):
    said = refused("record", "feedforward", *ARM, *QUICK[2:], "--out", tmp_path)
    assert said.startswith(f"soft-tendon record: error: {tmp_path}") and "Is a directory" in said


@pytest.mark.cases(
    "error, status, said",
    [
        (OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 1, "a.py: error: out/a.png: No space left on device"),
        (MemoryError("Unable to allocate 70 TiB"), 1, "a.py: error: there is too little memory: Unable to allocate 70 TiB"),
        (BrokenProcessPool("died"), 1, "a.py: error: a process of --workers was killed: it may have had too little memory"),
        (KeyboardInterrupt(), 130, "stopped: begin again"),
    ],
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


def test_a_damaged_run_is_left_out_of_the_curves(command, finished, tmp_path, monkeypatch, capsys):
    name = "evaluations.csv"
    for seed in (0, 1):
        shutil.copytree(finished, tmp_path / "runs" / "small" / f"seed_{seed}")
    DAMAGES["cut"](tmp_path / "runs" / "small" / "seed_1" / name)
    monkeypatch.chdir(tmp_path)
    only_plot = ("sweep", "small.toml", "--only-plot", "--out", "runs")
    command(*only_plot)
    printed = capsys.readouterr().out
    assert re.search(rf"left out: runs/small/seed_1/{name} ", printed) and "| small " in printed
    DAMAGES["cut"](tmp_path / "runs" / "small" / "seed_0" / name)
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
