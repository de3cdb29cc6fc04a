"""The wheel: what is in it, and that it works from outside of the clone."""

import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """A folder with the wheel in it, as site-packages has it, built without network; skips where hatchling is not installed."""
    if find_spec("hatchling") is None or find_spec("pip") is None:
        pytest.skip("hatchling or pip is not installed: pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder / "site")
    return folder / "site"


def test_all_that_ships_is_in_it(unpacked):
    names = {path.relative_to(unpacked).as_posix() for path in unpacked.rglob("*") if path.is_file()}
    (scripts,) = unpacked.glob("*/entry_points.txt")
    assert "soft-tendon = soft_tendon_env.cli.main:main" in scripts.read_text()
    for folder, inside in (
        ("soft_tendon_env/scene/library", "soft_tendon_env/scene/library"),
        ("configs", "soft_tendon_env/learning/configs"),
    ):
        assert {f"{inside}/{path.name}" for path in (ROOT / folder).glob("*.toml")} <= names
    trained = ROOT / "agents" / "trained"
    for path in (trained / "agents.toml", *(path for path in trained.glob("*/*/*") if path.is_file())):
        assert f"soft_tendon_env/policies/trained/{path.relative_to(trained).as_posix()}" in names
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "soft_tendon_env").rglob("*.py")}
    assert sources <= names and "soft_tendon_env/py.typed" in names
    assert not [name for name in names if name.startswith(("tests", "agents", "benchmarks")) or name.endswith((".pkl", ".zip"))]


def test_commands_work_from_an_empty_folder(unpacked, tmp_path):
    def said(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(unpacked), "SOFT_TENDON_ENV_QUIET": "1"}
        command = [sys.executable, "-m", "soft_tendon_env", *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True).stdout

    assert str(unpacked / "soft_tendon_env") in said("doctor")
    assert "| nominal " in said(*"evaluate agent --episodes 1 --seconds 0.4 --skip 0.1 --errors nominal".split())
    quick = ("steps=64", "arms=2", "seconds=0.4", "evaluation.episodes=1", "evaluation.skip=0.1", "hyperparameters.batch_size=64")
    said("train", "ppo_tip_pose", "--set", *quick)
