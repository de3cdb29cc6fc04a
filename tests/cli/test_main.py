"""The command line as a whole: every command has help, mistakes are one line, and the scripts of agents/ are the commands."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from soft_tendon_env.cli.main import COMMANDS, register_command
from soft_tendon_env.cli.options import attribute_texts, flag, is_table
from soft_tendon_env.tools import extensions
from soft_tendon_env.tools.configuration import Configuration

HEAVY = ("torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "pyarrow", "scipy.optimize", "joblib", "optuna")


def end_of(command, *arguments):
    with pytest.raises(SystemExit) as exit:
        command(*arguments)
    return exit.value.code


def configuration_of(name):
    """The class that has a command's options."""
    module = importlib.import_module(f"soft_tendon_env.cli.{name.replace('-', '_')}")
    classes = [value for value in vars(module).values() if isinstance(value, type) and issubclass(value, Configuration)]
    return next(kind for kind in classes if kind.__module__ == module.__name__)


@pytest.mark.cases("name", COMMANDS)
def test_help_has_every_option_with_a_text(command, capsys, name):
    kind = configuration_of(name)
    texts = attribute_texts(kind)
    assert texts.keys() >= kind.model_fields.keys(), "an attribute without a text is an option without help"
    assert end_of(command, name, "--help") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith(f"usage: soft-tendon {name} ")
    for name, field in kind.model_fields.items():
        assert is_table(field) or (texts[name].split()[0] in printed and f" {flag(kind, name)} " in printed)


def test_modules_of_a_users_own_come_first_in_every_process(tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(["examples", *sys.path])}
    run = [sys.executable, "-m", "soft_tendon_env", "--import", "own_metric"]

    def said(*given):
        return subprocess.run([*run, *given], cwd=Path(__file__).parents[2], env=environment, capture_output=True, text=True).stdout

    assert said("length", "three_tendon") == "0.3 m\n" and "  length           the length of a scene's rod" in said("--help")
    arm = "--scene three_tendon --fidelity fast --seconds 0.4 --skip 0.2 --episodes 1 --workers 2".split()
    table = said("evaluate", "tracking", *arm, "--errors", "nominal", "stiffness-50%", "--out", tmp_path)
    assert " peak [N] " in table and "\n| stiffness-50% " in table


@pytest.mark.cases(
    "given, message",
    [
        (
            ("--import", "no_such_module", "demo"),
            "--import names 'no_such_module': it should be a module, in this folder or on PYTHONPATH; No",
        ),
        (("--import",), "argument --import: expected one argument"),
    ],
)
def test_modules_that_are_not_there(command, capsys, monkeypatch, given, message):
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert end_of(command, *given) == 2 and extensions.extensions() == []
    assert capsys.readouterr().err.startswith(f"soft-tendon: error: {message}")


def test_a_command_keeps_its_name():
    with pytest.raises(ValueError, match="there is a command 'train' already"):
        register_command("train", "another")


def test_the_commands_are_listed(command, capsys):
    assert end_of(command, "--help") == 0
    printed = capsys.readouterr().out
    assert all(f"  {name} " in printed for name in COMMANDS)
    assert end_of(command) == 2


def test_help_and_the_package_load_nothing_that_extras_bring():
    code = "import sys, soft_tendon_env\nfrom soft_tendon_env.cli.main import main\n"
    code += "for name in sys.argv[1:]:\n    try:\n        main([name, '--help'])\n    except SystemExit:\n        pass\n"
    code += f"print(sorted(set(sys.modules) & set({HEAVY!r})), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *COMMANDS], capture_output=True, text=True)
    assert done.stderr.splitlines() == ["[]"]
