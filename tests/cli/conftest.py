"""Commands in this process, and an agent for them."""

import json

import gymnasium as gym
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.envs import IDS

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.fixture(scope="session")
def command():
    """command("evaluate", *arguments): `soft-tendon evaluate` in this process."""
    return lambda *arguments: main([str(argument) for argument in arguments])


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
