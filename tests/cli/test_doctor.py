"""`soft-tendon doctor` says what is broken, and what can be installed."""

import gymnasium as gym
import pytest

from soft_tendon_env.cli import doctor, errors
from soft_tendon_env.envs import IDS


def examine(command, capsys):
    with pytest.raises(SystemExit) as exit:
        command("doctor")
    return exit.value.code, capsys.readouterr().out


@pytest.fixture
def in_this_process(monkeypatch):
    """Leaves out what takes a process of its own."""
    monkeypatch.setattr(doctor, "second_process", lambda: iter(()))


def test_all_is_well(command, capsys):
    code, printed = examine(command, capsys)
    assert code == 0 and printed.endswith("all is well\n") and "BROKEN" not in printed
    states = "soft_tendon_env/", "compiled nothing", "torch "
    for name in (*IDS.values(), "numpy ", "paper_16dof", "ppo_tip_pose", *states):
        assert name in printed


def test_a_task_that_does_not_work_is_broken_and_the_others_are_tried(command, capsys, monkeypatch, in_this_process):
    make = gym.make

    def fail(id, **options):
        if "Shape" in id:
            raise RuntimeError("the compiler is gone")
        return make(id, **options)

    monkeypatch.setattr(gym, "make", fail)
    code, printed = examine(command, capsys)
    assert code == 1 and "TendonRod-Shape-v0 BROKEN: RuntimeError, the compiler is gone" in printed
    assert "TendonRod-TipPose-v0 made and reset" in printed and printed.endswith("broken: TendonRod-Shape-v0\n")


def test_packages_that_are_missing_or_out_of_bounds_are_broken(capsys, monkeypatch):
    listed = ["numpy<3,>=2.2", "numba>=99", "not-there>=1", "torch<1; extra == 'agents'", "ray[rllib]<1; extra == 'rllib'"]
    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda name: listed)
    assert not doctor.holds("packages", doctor.packages) and not doctor.holds("agents", lambda: doctor.extra("agents"))
    core, extra = (line for line in capsys.readouterr().out.splitlines() if "BROKEN" in line)
    assert core.endswith('not-there is missing: pip install "not-there>=1"') and 'pip install "numba>=99"' in core and "numpy" not in core
    assert 'pip install "torch<1"' in extra and "ray" not in extra


def test_an_extra_that_is_missing_is_not_broken_but_can_be_installed(capsys, monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda module: None)
    assert doctor.holds("recording", lambda: doctor.extra("recording"))
    assert 'not installed: pip install "soft_tendon_env[recording]"' in capsys.readouterr().out


def test_an_extra_that_cannot_be_imported_is_broken(capsys, monkeypatch):
    def fail(module):
        raise ImportError(f"{module} was built for another machine")

    monkeypatch.setattr(doctor.importlib, "import_module", fail)
    assert not doctor.holds("agents", lambda: doctor.extra("agents"))
    assert "BROKEN: torch cannot be imported: ImportError, torch was built" in capsys.readouterr().out


def test_a_second_process_finds_what_the_first_has_compiled(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "SECOND", "from soft_tendon_env.mechanics.algebra.linear import row_stride\nrow_stride(3)  # {id}")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert "compiled nothing" in next(doctor.second_process())


@pytest.mark.parametrize("is_kept", [True, False])
def test_a_second_process_that_compiles_again_is_told(capsys, monkeypatch, tmp_path, is_kept):
    """It is broken where there is a folder that keeps machine code."""
    monkeypatch.setattr(doctor, "SECOND", "import sys\nsys.exit(print('compiling for first use', file=sys.stderr))  # {id}")
    monkeypatch.setattr("soft_tendon_env.compiler.compilation.cache_folder", lambda: tmp_path if is_kept else None)
    assert doctor.holds("second process", doctor.second_process) is not is_kept
    printed = capsys.readouterr().out
    assert "compiled again what the one before it had compiled" in printed and ("BROKEN" in printed) == is_kept
