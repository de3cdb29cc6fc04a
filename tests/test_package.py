"""What `import soft_tendon_env` gives, and what it does not wait for."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import soft_tendon_env as ste
from soft_tendon_env import public

ROOT = Path(__file__).parent.parent
IMPORTS = """
import sys
import gymnasium, soft_tendon_env
import soft_tendon_env.cli.main as cli
cli.usage()
assert {f"TendonRod-{task}-v1" for task in ("Reach", "Shape", "TipPose")} <= {*gymnasium.registry}
assert not {"numba", "scipy", "soft_tendon_env.envs"} & {*sys.modules}
import soft_tendon_env.envs
extras = {"torch", "stable_baselines3", "sb3_contrib", "ray", "rerun", "matplotlib", "pandas", "tqdm"}
assert not extras & {*sys.modules}, extras & {*sys.modules}
"""
APART = {"rllib", "peers", "check", "docs", "dist"}
"""Extras that have environments of their own, or no part in what the package computes."""
OPEN = {"numba"}
"""Dependencies without an upper bound: of numba, only what its manual describes is used (tests/compiler)."""


def test_every_public_name_is_there():
    assert set(public.__all__) == set(ste.__all__) <= set(dir(ste))
    assert all(getattr(ste, name) is getattr(public, name) for name in public.__all__)
    scope = {}
    exec("from soft_tendon_env import *", scope)
    assert scope.keys() >= set(public.__all__)


def test_one_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert ste.__version__ == version
    assert re.findall(r"^## \[([\d.]+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[0] == version


def test_importing_waits_for_no_compiler_and_brings_no_library_of_an_extra():
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)


def test_every_dependency_has_bounds_and_the_lower_ones_are_those_of_the_lowest_environment():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [requirement for extra, listed in project["optional-dependencies"].items() if extra not in APART for requirement in listed]
    listed = [*project["dependencies"], *extras]
    bounds = [
        re.fullmatch(r"([\w-]+)>=([\d.]+)(,<[\d.]+)?", requirement)
        for requirement in listed
        if not requirement.startswith("soft_tendon_env[")
    ]
    assert all(bounds), listed
    assert {found[1] for found in bounds if not found[3]} == OPEN
    lowest = dict(line.split("==") for line in (ROOT / "constraints-lowest.txt").read_text().splitlines() if not line.startswith("#"))
    assert {found[1] for found in bounds} == set(lowest)
    for found in bounds:
        assert f"{lowest[found[1]]}.".startswith(f"{found[2]}."), found[0]
