"""The command line as a whole: every command has help, mistakes are one line, and the scripts of agents/ are the commands."""

import importlib
import subprocess
import sys

import pytest

from soft_tendon_env.cli.main import COMMANDS
from soft_tendon_env.cli.options import attribute_texts, flag, is_table
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
