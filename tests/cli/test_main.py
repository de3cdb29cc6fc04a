"""The command line as a whole: every command has help, mistakes are one line, and the scripts of agents/ are the commands."""

import importlib
import subprocess
import sys

import pytest

from soft_tendon_env.cli import errors
from soft_tendon_env.cli.main import COMMANDS
from soft_tendon_env.cli.options import attribute_texts, flag, is_table
from soft_tendon_env.tools.configuration import Configuration

HEAVY = ("torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "pyarrow")


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


@pytest.mark.cases(
    "arguments, said",
    [
        (("trian",), "soft-tendon: error: 'trian' is no command: did you mean 'train'?"),
        (("evaluate",), "soft-tendon evaluate: error: the following arguments are required: policy"),
        (("evaluate", "tracking", "--episode", "3"), "--episode is no option: did you mean '--episodes'? valid: --cluster, --episodes, "),
        (("evaluate", "tracking", "--episodes", "300"), "--episodes is 300: it should be at most 20"),
        (("evaluate", "tracking", "--episodes", "3.5"), "--episodes is '3.5': it should be a valid integer"),
        (("evaluate", "tracking", "--seconds", "nan"), "--seconds is nan: it should be"),
        (("evaluate", "tracking", "--task", "Tip"), "--task is 'Tip': it should be a task: did you mean 'TipPose'? valid: Reach, "),
        (("evaluate", "tracking", "--fidelity", "quick"), "--fidelity is 'quick': it should be 'fast', 'standard', 'fine', 'scene' or a"),
        (("evaluate", "tracking", "--options", '{"fidelity": "quick"}'), "--options: fidelity is 'quick': it should be"),
        (("evaluate", "tracking", "--options", "{"), "--options '{' is not JSON"),
        (("compare", "--task", "Tip"), "--task[0] is 'Tip': it should be"),
        (("compare", "--workers", "0"), "--workers is 0: it should be greater than or equal to 1"),
        (("record", "tracking", "--seeds", "-1"), "--seeds[0] is -1: it should be greater than or equal to 0"),
        (("train", "ppo_tip_pos"), "neither the path of a .toml file nor a training that ships: did you mean 'ppo_tip_pose'?"),
        (("train", "ppo_tip_pose", "--seed", "one"), "--seed is 'one': it should be a valid integer"),
        (("sweep", "ppo_tip_pose", "--seeds", "0"), "--seeds is 0: it should be greater than or equal to 1"),
        (("reproduce-paper", "--seconds", "11"), "--seconds is 11.0: it should be less than or equal to 10"),
        (("scenes", "papr"), "'papr': is neither the path of a .toml file nor a scene that ships: did you mean 'paper'?"),
        (("effects", "gravty"), "name is 'gravty': did you mean 'gravity'?"),
        (("doctor", "now"), "unrecognized arguments: now"),
    ],
)
def test_a_mistake_is_one_line(command, capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert end_of(command, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("soft-tendon") and ": error: " in line and said in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments, missing",
    [
        (("evaluate", "feedforward"), "pictures"),
        (("compare",), "pictures"),
        (("record", "feedforward"), "recording"),
        (("reproduce-paper",), "pictures"),
        (("train", "ppo_tip_pose"), "agents"),
        (("sweep", "ppo_tip_pose"), "agents,pictures"),
        (("demo",), "agents,recording,pictures"),
    ],
)
def test_missing_extras_are_one_line_with_the_command_that_installs_them(command, capsys, tmp_path, monkeypatch, arguments, missing):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(errors, "find_spec", lambda module: None)
    assert end_of(command, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    found = line.partition('pip install "soft_tendon_env[')[2].removesuffix(']"')
    assert sorted(found.split(",")) == sorted(missing.split(","))


def test_help_and_the_package_load_nothing_that_extras_bring():
    code = "import sys, soft_tendon_env\nfrom soft_tendon_env.cli.main import main\n"
    code += "for name in sys.argv[1:]:\n    try:\n        main([name, '--help'])\n    except SystemExit:\n        pass\n"
    code += f"print(sorted(set(sys.modules) & set({HEAVY!r})), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *COMMANDS], capture_output=True, text=True)
    assert done.stderr.splitlines() == ["[]"]
