"""Commands in this process, and a small training with its agent for them."""

import re

import pytest
import tomli_w

from soft_tendon_env.cli.main import main
from soft_tendon_env.learning.config import read_training


@pytest.fixture(scope="session")
def command():
    """command("evaluate", *arguments): `soft-tendon evaluate` in this process."""
    return lambda *arguments: main([str(argument) for argument in arguments])


@pytest.fixture
def refused(command, monkeypatch, capsys, tmp_path):
    """refused("evaluate", *arguments): the message with which a command refuses them, with exit
    status 2 and before it writes anything."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        before = {*tmp_path.rglob("*")}
        with pytest.raises(SystemExit) as exit:
            command(*arguments)
        said = [
            line
            for line in capsys.readouterr().err.splitlines()
            if not line.startswith("soft_tendon_env: compil")
        ]
        assert exit.value.code == 2, said
        assert {*tmp_path.rglob("*")} == before, said
        assert len(said) < 16, said
        return " ".join(re.sub(r"[│─╭╮╰╯|]|\+?-{3,}\+?", "", "\n".join(said)).split())

    return run


@pytest.fixture(scope="session")
def config(tmp_path_factory, table):
    """The file of a small training."""
    path = tmp_path_factory.mktemp("configs") / "small.toml"
    path.write_text(tomli_w.dumps({**table, "steps": 128, "normalise": {"observations": True}}))
    return path


@pytest.fixture(scope="session")
def finished(tmp_path_factory, config):
    """The folder of a training that is done: look, but change copies only."""
    from soft_tendon_env.learning import train

    folder = tmp_path_factory.mktemp("runs") / "run"
    train.train(read_training(config), folder)
    return folder
