"""Modules of a user's own: an installed package's by its entry points, others by name; processes
that work for this one have them too."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from soft_tendon_env.tools import extensions
from soft_tendon_env.tools.parallel import run_all

ROOT = Path(__file__).parents[2]
TASK = """
from soft_tendon_env import register
from soft_tendon_env.envs import TASKS

register("task", "OfPackage", TASKS["TipPose"])
"""
COMMAND = """
from soft_tendon_env import register


@register("command", "of-package", description="a command of a package")
def command(arguments):
    print("printed by of-package:", *arguments)
"""
BROKEN = "import no_such_library\n"
ENTRY_POINTS = """
[soft_tendon_env]
task = own_package.task
broken = own_package.broken
command = own_package.command
"""


@pytest.fixture
def python(tmp_path):
    """python("-c", code): a process's streams, where a package with ENTRY_POINTS is installed."""
    package = tmp_path / "own_package"
    metadata = tmp_path / "own_package-1.0.dist-info"
    package.mkdir()
    metadata.mkdir()
    (package / "__init__.py").touch()
    (package / "task.py").write_text(TASK)
    (package / "command.py").write_text(COMMAND)
    (package / "broken.py").write_text(BROKEN)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: own-package\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)

    def run(*arguments):
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path,
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        )

    return run


def warnings_of(process):
    """Warnings on the stderr of a process, without the lines of code below them."""
    return [line for line in process.stderr.splitlines() if "Warning: " in line]


@pytest.mark.slow
def test_importing_the_package_loads_the_entry_points_and_names_those_that_fail(python):
    code = """
        import gymnasium
        import soft_tendon_env
        from soft_tendon_env.cli.main import COMMANDS

        assert "TendonRod-OfPackage-v0" in gymnasium.registry
        assert COMMANDS["of-package"].description == "a command of a package"
    """
    (warning,) = warnings_of(python("-c", textwrap.dedent(code)))
    assert warning.endswith(
        "RuntimeWarning: own-package is left out: its entry point 'broken' of the group"
        " 'soft_tendon_env', own_package.broken, cannot be loaded: ModuleNotFoundError, No module"
        " named 'no_such_library'"
    )


@pytest.mark.slow
def test_the_package_may_be_imported_first(python):
    """Its module is then at work when soft_tendon_env loads the entry points."""
    python("-c", "import own_package.task, gymnasium; gymnasium.spec('TendonRod-OfPackage-v0')")


@pytest.mark.slow
def test_the_command_line_has_what_packages_register(python):
    process = python("-m", "soft_tendon_env", "of-package", "one", "two")
    assert process.stdout == "printed by of-package: one two\n"


@pytest.mark.slow
def test_worker_processes_load_them_too(python):
    code = """
        from soft_tendon_env.envs import TASKS
        from soft_tendon_env.tools.parallel import run_all

        def worker_has_task(run):
            import soft_tendon_env.envs

            return "OfPackage" in soft_tendon_env.envs.TASKS

        if __name__ == "__main__":
            print(run_all(worker_has_task, range(2), 2, "workers"))
    """
    process = python("-W", "ignore", "-c", textwrap.dedent(code))
    assert process.stdout == "[True, True]\n"


def test_where_no_package_has_the_group_none_is_looked_for(monkeypatch, tmp_path):
    metadata = tmp_path / "other-1.0.dist-info"
    metadata.mkdir()
    (metadata / "entry_points.txt").write_text("[console_scripts]\nsoft_tendon_env = other:main\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(tmp_path / "absent")])
    assert not extensions._is_group_in_use()
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)
    assert extensions._is_group_in_use()


def has_module(run):
    return "xml.dom.minicompat" in sys.modules


@pytest.mark.slow
def test_worker_processes_import_the_modules_that_this_one_was_told(monkeypatch):
    monkeypatch.setattr(extensions, "_imported", [])
    extensions.import_modules(["xml.dom.minicompat", "xml.dom.minicompat"])
    assert extensions.imported_modules() == ("xml.dom.minicompat",)
    assert run_all(has_module, range(3), 2, "imports") == [True] * 3
