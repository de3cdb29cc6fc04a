"""Commands in this process, an agent and a training for them."""

import json

import gymnasium as gym
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.control import ControllerOutput
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning import train
from soft_tendon_env.learning.config import read_training

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
}


@pytest.fixture(scope="session")
def command():
    """command("evaluate", *arguments): `soft-tendon evaluate` in this process."""
    return lambda *arguments: main([str(argument) for argument in arguments])


@pytest.fixture
def refused(command, monkeypatch, capsys, tmp_path):
    """refused("evaluate", *arguments): the one line in which a command refuses them, with exit status 2 and before it writes anything."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        before = {*tmp_path.rglob("*")}
        with pytest.raises(SystemExit) as exit:
            command(name, *arguments)
        (line,) = (said for said in capsys.readouterr().err.splitlines() if not said.startswith("soft_tendon_env: compil"))
        assert exit.value.code == 2 and line.startswith("soft-tendon") and ": error: " in line and {*tmp_path.rglob("*")} == before, line
        return line

    return run


@pytest.fixture(scope="session")
def config(tmp_path_factory):
    """The file of a small training."""
    import tomli_w

    path = tmp_path_factory.mktemp("configs") / "small.toml"
    path.write_text(tomli_w.dumps(TABLE))
    return path


@pytest.fixture(scope="session")
def finished(tmp_path_factory, config):
    """The folder of a training that is done: look, but change copies only."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train.train(read_training(config), folder)
    return folder


@pytest.fixture(scope="session")
def small():
    """Options of an environment that is quick."""
    return SMALL


@pytest.fixture(scope="session")
def agent(tmp_path_factory):
    """agent(scene=..., ...): the file best/model.zip of Stable-Baselines3, of an agent that has learned nothing; each time another."""
    from stable_baselines3 import PPO

    def save(**changes):
        options = {**SMALL, **changes}
        folder = tmp_path_factory.mktemp("run") / "best"
        folder.mkdir()
        PPO("MlpPolicy", gym.make(IDS["TipPose"], **options), n_steps=8, batch_size=4, seed=0, device="cpu").save(folder / "model.zip")
        (folder / "config.json").write_text(json.dumps({"options": options}))
        return folder / "model.zip"

    return save


class Share:
    def __init__(self, share):
        self._share = share

    def __call__(self, model, limits, period):
        self._tension = limits[:, 0] + self._share * (limits[:, 1] - limits[:, 0])
        return self

    def act(self, now, memory=None):
        return ControllerOutput(self._tension)


@pytest.fixture
def pulling():
    """pulling(share): what makes a controller that pulls with a share of what it may, all tendons alike."""
    return Share


@pytest.fixture(scope="session")
def recorded():
    """recorded(path): steps of the timeline by arm, of a Rerun file."""
    chunks = pytest.importorskip("rerun.chunk")

    def read(path):
        steps = {}
        for chunk in chunks.RrdReader(path).stream():
            if chunk.entity_path.startswith("/tension/") and not chunk.is_static:
                arm = chunk.entity_path.removeprefix("/tension/").replace("\\", "")
                steps[arm] = steps.get(arm, []) + chunk.to_record_batch()["step"].to_pylist()
        return steps

    return read
