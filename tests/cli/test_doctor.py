"""`soft-tendon doctor` says what is broken, and what can be installed."""

import gymnasium as gym
import pytest

from soft_tendon_env.cli import doctor, errors
from soft_tendon_env.envs import IDS


def examine(command, capsys):
    with pytest.raises(SystemExit) as exit:
        command("doctor")
    return exit.value.code, capsys.readouterr().out


def test_all_is_well(command, capsys):
    code, printed = examine(command, capsys)
    assert code == 0 and printed.endswith("all is well\n") and "BROKEN" not in printed
    for name in (*IDS.values(), "numpy ", "paper_16dof", "ppo_tip_pose", "can be written"):
        assert name in printed


def test_a_task_that_does_not_work_is_broken(command, capsys, monkeypatch):
    make = gym.make

    def fail(id, **options):
        if "Shape" in id:
            raise RuntimeError("the compiler is gone")
        return make(id, **options)

    monkeypatch.setattr(gym, "make", fail)
    code, printed = examine(command, capsys)
    assert code == 1 and "TendonRod-Shape-v0 BROKEN: RuntimeError, the compiler is gone" in printed
    assert "TendonRod-Reach-v0 made and reset" in printed and printed.endswith("broken: tasks\n")


def test_a_package_that_is_missing_is_broken(command, capsys, monkeypatch):
    monkeypatch.setattr(doctor, "PACKAGES", ("numpy", "not_there"))
    code, printed = examine(command, capsys)
    assert code == 1 and "BROKEN: not_there missing" in printed


def test_an_extra_that_is_missing_is_not_broken_but_can_be_installed(command, capsys, monkeypatch):
    find = errors.find_spec
    monkeypatch.setattr(errors, "find_spec", lambda module: None if module == "rerun" else find(module))
    code, printed = examine(command, capsys)
    assert code == 0 and 'not installed: recording; pip install "soft_tendon_env[recording]"' in printed


def test_an_extra_that_cannot_be_imported_is_broken(command, capsys, monkeypatch):
    def fail(module):
        raise ImportError(f"{module} was built for another machine")

    monkeypatch.setattr(doctor.importlib, "import_module", fail)
    holds = doctor.extras()
    printed = capsys.readouterr().out
    assert not holds and "BROKEN: torch of the extra agents cannot be imported: ImportError, torch was built" in printed
