"""What `import soft_tendon_env` gives and does not wait for; what is in the wheel, and that it
works from outside of the clone."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

import soft_tendon_env as ste
from soft_tendon_env import public

ROOT = Path(__file__).parent.parent
IMPORTS = """
import sys
import gymnasium, soft_tendon_env
import soft_tendon_env.cli.main as cli
cli.usage()
assert {f"TendonRod-{task}-v0" for task in ("Reach", "Shape", "TipPose")} <= {*gymnasium.registry}
assert not {"numba", "scipy", "soft_tendon_env.envs"} & {*sys.modules}
import soft_tendon_env.envs
extras = {"torch", "stable_baselines3", "sb3_contrib", "ray", "rerun", "matplotlib", "pandas"}
extras |= {"tqdm"}
assert not extras & {*sys.modules}, extras & {*sys.modules}
"""
APART = {"rllib", "peers", "check", "docs", "dist"}
"""Extras that have environments of their own, or no part in what the package computes."""
OPEN = {"numba"}
"""Dependencies without an upper bound: of numba, only what its manual describes is used
(tests/compiler)."""


def test_every_public_name_is_there():
    assert set(public.__all__) == set(ste.__all__) <= set(dir(ste))
    assert all(getattr(ste, name) is getattr(public, name) for name in public.__all__)
    scope = {}
    exec("from soft_tendon_env import *", scope)
    assert scope.keys() >= set(public.__all__)


def test_modules_but_the_package_itself_write_the_names_that_they_have():
    """None is made when it is asked for, so that editors and type checkers find its definition."""
    lazy = []
    for path in (ROOT / "soft_tendon_env").rglob("*.py"):
        if re.search(r"^ {0,4}def __getattr__\(name", path.read_text(), re.MULTILINE):
            lazy.append(path.relative_to(ROOT).as_posix())
    assert lazy == ["soft_tendon_env/__init__.py"]


def test_one_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert ste.__version__ == version
    assert (
        re.findall(r"^## \[([\d.]+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[0]
        == version
    )


def test_importing_waits_for_no_compiler_and_brings_no_library_of_an_extra():
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)


def test_every_dependency_has_bounds_and_the_lower_ones_are_those_of_the_lowest_environment():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [
        requirement
        for extra, listed in project["optional-dependencies"].items()
        if extra not in APART
        for requirement in listed
    ]
    listed = [
        one for one in (*project["dependencies"], *extras) if not one.startswith("soft_tendon_env[")
    ]
    bounds = [re.fullmatch(r"([\w-]+)>=([\d.]+)(,<[\d.]+)?", requirement) for requirement in listed]
    assert all(bounds), listed
    assert {found[1] for found in bounds if not found[3]} == OPEN
    lowest = dict(
        line.split("==")
        for line in (ROOT / "constraints-lowest.txt").read_text().splitlines()
        if not line.startswith("#")
    )
    assert {found[1] for found in bounds} == set(lowest)
    for found in bounds:
        assert f"{lowest[found[1]]}.".startswith(f"{found[2]}."), found[0]


def test_the_workflow_runs_the_parts_of_the_script_on_every_python_that_is_named():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    prefix = "Programming Language :: Python :: 3."
    named = {
        classifier.removeprefix("Programming Language :: Python :: ")
        for classifier in project["classifiers"]
        if classifier.startswith(prefix)
    }
    oldest = min(named, key=lambda version: int(version.removeprefix("3.")))
    assert project["requires-python"] == f">={oldest}"

    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    assert set(jobs["test"]["strategy"]["matrix"]["python"]) == named
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    rows = jobs["versions"]["strategy"]["matrix"]["include"]
    assert {row["python"] for row in rows} <= named
    targets = {row["target"] for row in rows}
    for command in commands:
        if command != "make ${{ matrix.target }}":
            targets.add(command.removeprefix("make "))
    script = (ROOT / ".ci/run").read_text()
    parts = re.findall(r"^make (\S+)$", script, re.MULTILINE)
    assert targets == {*parts, "test"}  # which test-all begins with


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """A folder with the wheel in it, as site-packages has it, built without network; skips where
    hatchling is not installed."""
    if find_spec("hatchling") is None or find_spec("pip") is None:
        pytest.skip("hatchling or pip is not installed: pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--quiet",
        "--wheel-dir",
        folder,
        ROOT,
    ]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder / "site")
    return folder / "site"


@pytest.mark.slow
def test_all_that_ships_is_in_the_wheel(unpacked):
    names = {
        path.relative_to(unpacked).as_posix() for path in unpacked.rglob("*") if path.is_file()
    }
    (scripts,) = unpacked.glob("*/entry_points.txt")
    assert "soft-tendon = soft_tendon_env.cli.main:main" in scripts.read_text()
    for folder, inside in (
        ("soft_tendon_env/scene/library",) * 2,
        ("configs", "soft_tendon_env/learning/configs"),
    ):
        assert {f"{inside}/{path.name}" for path in (ROOT / folder).glob("*.toml")} <= names
    trained = ROOT / "agents" / "trained"
    table = tomllib.loads((trained / "agents.toml").read_text())
    assert "soft_tendon_env/policies/trained/agents.toml" in names
    for folder in trained.glob("*/*/"):
        agent_name, task = folder.relative_to(trained).parts
        in_wheel = agent_name not in table["repository_alone"][task]
        for path in (folder / "config.json", folder / "weights.npz"):
            place = path.relative_to(trained).as_posix()
            assert (f"soft_tendon_env/policies/trained/{place}" in names) == in_wheel
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "soft_tendon_env").rglob("*.py")}
    assert sources <= names
    assert "soft_tendon_env/py.typed" in names
    assert not [
        name
        for name in names
        if name.startswith(("tests", "agents", "benchmarks"))
        or name.endswith((".pkl", ".zip", ".pt"))
        or "/seed_" in name
    ]


@pytest.mark.slow
def test_commands_of_the_wheel_work_from_an_empty_folder(unpacked, tmp_path):
    def said(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(unpacked), "SOFT_TENDON_ENV_QUIET": "1"}
        command = [sys.executable, "-m", "soft_tendon_env", *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True
        ).stdout

    assert str(unpacked / "soft_tendon_env") in said("doctor")
    assert "| nominal " in said(
        *[
            "evaluate",
            "agent",
            "--episodes",
            "1",
            "--seconds",
            "0.4",
            "--skip",
            "0.1",
            "--errors",
            "nominal",
        ]
    )
    quick = (
        "steps=64",
        "arms=2",
        "seconds=0.4",
        "evaluation.episodes=1",
        "evaluation.skip=0.1",
        "hyperparameters.batch_size=64",
    )
    said("train", "ppo_tip_pose_nominal", "--set", *quick)
