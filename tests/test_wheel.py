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
def wheel(tmp_path_factory):
    """The file, built without network; skips where hatchling is not installed."""
    if find_spec("hatchling") is None or find_spec("pip") is None:
        pytest.skip("hatchling or pip is not installed: pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def unpacked(wheel, tmp_path_factory):
    """A folder with the wheel in it, as site-packages has it."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder)
    return folder


def test_all_that_ships_is_in_it(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
        scripts = next(file.read(name).decode() for name in names if name.endswith("entry_points.txt"))
    assert "soft-tendon = soft_tendon_env.cli.main:main" in scripts
    for folder, inside in (("soft_tendon_env/scene/library", None), ("configs", "soft_tendon_env/learning/configs")):
        for path in (ROOT / folder).glob("*.toml"):
            assert f"{inside or folder}/{path.name}" in names
    trained = ROOT / "agents" / "trained"
    for path in (trained / "agents.toml", *(path for path in trained.glob("*/*/*") if path.is_file())):
        assert f"soft_tendon_env/policies/trained/{path.relative_to(trained).as_posix()}" in names
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "soft_tendon_env").rglob("*.py")}
    assert sources <= names and "soft_tendon_env/py.typed" in names
    assert not [name for name in names if name.startswith(("tests", "agents", "benchmarks")) or name.endswith((".pkl", ".zip"))]


def call(unpacked, folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(unpacked), "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, "-m", "soft_tendon_env", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_commands_work_from_an_empty_folder(unpacked, tmp_path):
    doctor = call(unpacked, tmp_path, "doctor")
    assert doctor.returncode == 0 and str(unpacked / "soft_tendon_env") in doctor.stdout, doctor.stdout + doctor.stderr
    assert "| paper " in call(unpacked, tmp_path, "scenes").stdout
    evaluated = call(unpacked, tmp_path, *"evaluate agent --episodes 1 --seconds 0.4 --skip 0.1 --errors nominal".split())
    assert evaluated.returncode == 0 and "| nominal " in evaluated.stdout, evaluated.stderr
    quick = ("steps=64", "arms=2", "seconds=0.4", "evaluation.episodes=1", "evaluation.skip=0.1", "hyperparameters.batch_size=64")
    trained = call(unpacked, tmp_path, "train", "ppo_tip_pose", "--set", *quick)
    assert trained.returncode == 0, trained.stderr
