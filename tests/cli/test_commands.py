"""Every command once, at its smallest: what it prints and what it leaves."""

import importlib.metadata
import re
import subprocess
import sys

import gymnasium as gym
import pytest

from soft_tendon_env import register
from soft_tendon_env.accuracy import proper_orthogonal_fields
from soft_tendon_env.cli import doctor
from soft_tendon_env.cli.main import COMMANDS, shipped_command
from soft_tendon_env.compiler.kept_code import cache_folder
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.tools import files

ARM = ("--scene", "three_tendon", "--fidelity", "fast")
SHORT = ("--seconds", "0.2", "--skip", "0.1")
BRIEF = ("--robot-options", "real_time=false", "--motions", "1", "--holds", "1", "--hold", "0.1")
HEAVY = (
    "torch",
    "stable_baselines3",
    "sb3_contrib",
    "rerun",
    "matplotlib",
    "pyarrow",
    "scipy.optimize",
    "joblib",
    "optuna",
)
QUICK = [
    (("scenes",), ["| paper_16dof ", "| 10 "], []),
    (("scenes", "paper"), [(SHIPPED / "paper.toml").read_text()], []),
    (("effects",), [f"[effects.{name}]" for name in EFFECTS], []),
    (("effects", "gravity"), ["[effects.gravity]\n", "\n  acceleration: required; "], []),
    (
        ("evaluate", "feedforward", *ARM, *SHORT, "--errors", "nominal", "--episodes", "1"),
        ["\n| nominal "],
        ["evaluate/TipPose.png"],
    ),
    (
        (
            "compare",
            "--task",
            "Shape",
            "--policies",
            "feedforward",
            "tracking",
            *ARM,
            *SHORT,
            "--errors",
            "nominal",
            "--episodes",
            "1",
        ),
        ["\n| feedforward ", "\n| tracking ", "1 episodes of 0.2 s"],
        ["compare/Shape.csv", "compare/Shape.json"],
    ),
    (
        ("collect", "three_tendon", "--fidelity", "fast", *BRIEF),
        ["1 motions of 2 commands, 0.1 s each\n", "tendons slack\n"],
        ["collected/motions.csv", "collected/markers.toml"],
    ),
    (
        ("record", "feedforward", *ARM, *SHORT),
        ["`rerun out/side_by_side.rrd`"],
        ["side_by_side.rrd"],
    ),
    pytest.param(
        ("record", "{best}", "feedforward", *SHORT),
        ["\n| feedforward "],
        ["side_by_side.rrd"],
        marks=pytest.mark.slow,
    ),
    pytest.param(
        ("export", "{best}"),
        ["| tip_pose ", "the command [N] of 3 tendons, 50 times a second"],
        ["agent.onnx"],
        marks=pytest.mark.slow,
    ),
    pytest.param(
        ("export", "three_tendon", "--mjcf", "--links", "2"),
        ["(2 links)"],
        ["three_tendon.xml"],
        marks=pytest.mark.slow,
    ),
    (
        ("train", "{config}", "--seed", "3"),
        ["PPO on TipPose, 128 steps, seed 3"],
        ["runs/small/seed_3/best/weights.npz"],
    ),
    pytest.param(
        ("demo", "--episodes", "1", "--seconds", "0.2"),
        ["\n| agent (APG) ", "\n| PPO ", "cannot push"],
        ["demo.rrd", "demo.png"],
        marks=pytest.mark.slow,  # it draws
    ),
    pytest.param(
        ("accuracy", "three_tendon", "--within", "5mm"),
        ["| fine ", "| 5mm ", "written: "],
        ["accuracy/three_tendon_5mm.toml"],
        marks=pytest.mark.slow,  # trials of nine accuracies
    ),
    pytest.param(
        ("fields", "three_tendon", "--within", "9cm"),
        ["three_tendon, digest ", 'passive = { type = "snapshots", fields = '],
        [],
        marks=pytest.mark.slow,  # it makes fields
    ),
    (
        ("doctor", "--scene", "three_tendon"),
        [
            f"soft_tendon_env   {importlib.metadata.version('soft_tendon_env')} in ",
            f"torch             {importlib.metadata.version('torch')}, a build for ",
            f"sb3-contrib       {importlib.metadata.version('sb3-contrib')}\n",
            "TendonRod-Reach-v0 one step in ",
            " ms\n",
            "all is well\n",
        ],
        [],
    ),
]


@pytest.fixture(autouse=True)
def small(monkeypatch, tmp_path):
    """Few passive fields in a folder of their own."""

    monkeypatch.chdir(tmp_path)
    cache_folder()  # of kernels, which stays as it is
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path / "cache"])
    for name, value in (("RUNS", 1), ("TESTS", 1), ("COUNTS", (0, 3))):
        monkeypatch.setattr(proper_orthogonal_fields, name, value)


@pytest.mark.parametrize(
    ("arguments", "printed", "left"),
    QUICK,
    ids=lambda value: value[0] if value and value[0] in COMMANDS else "",
)
def test_commands_print_and_leave_what_they_should(
    command, capsys, tmp_path, request, arguments, printed, left
):
    known = {}
    if "{config}" in arguments:
        known["config"] = request.getfixturevalue("config")
    if "{best}" in arguments:
        known["best"] = request.getfixturevalue("finished") / "best"
    ended = 0
    try:
        command(*(argument.format(**known) for argument in arguments))
    except SystemExit as exit:
        ended = exit.code
    said = capsys.readouterr().out
    assert not ended, said
    assert all(text in said for text in printed), said
    assert all((tmp_path / "out" / name).stat().st_size > 100 for name in left)


def test_a_task_that_does_not_work_is_broken_and_the_others_are_tried(command, capsys, monkeypatch):
    make = gym.make
    monkeypatch.setattr(
        gym, "make", lambda id, **options: 1 / 0 if "Shape" in id else make(id, **options)
    )
    with pytest.raises(SystemExit, match="1"):
        command("doctor", "--scene", "three_tendon")
    printed = capsys.readouterr().out
    assert "TendonRod-Shape-v0 BROKEN: ZeroDivisionError" in printed
    assert "TendonRod-TipPose-v0 one step in " in printed


def test_the_doctor_names_the_extra_of_a_library_that_is_not_there(monkeypatch):
    installed = importlib.metadata.version

    def version(name):
        if name == "rerun-sdk":
            raise importlib.metadata.PackageNotFoundError(name)
        return installed(name)

    monkeypatch.setattr(importlib.metadata, "version", version)
    expected = 'not installed: pip install "soft_tendon_env[recording]"'
    assert doctor.library_version("rerun-sdk") == expected
    assert doctor.library_version("sb3-contrib") == installed("sb3-contrib")


@pytest.mark.parametrize(
    ("cuda", "hip", "expected"),
    [
        (None, None, "a build for CPUs"),
        ("13.0", None, "a build for CUDA 13.0, of which this package uses the CPU alone"),
        (None, "7.1", "a build for ROCm 7.1, of which this package uses the CPU alone"),
    ],
)
def test_the_doctor_names_the_build_of_torch(monkeypatch, cuda, hip, expected):
    version = pytest.importorskip("torch").version
    monkeypatch.setattr(version, "cuda", cuda)
    monkeypatch.setattr(version, "hip", hip)
    assert doctor.torch_build() == expected


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_every_option_with_a_text(command, capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "300")
    kind = shipped_command(name)[1]
    with pytest.raises(SystemExit, match="0"):
        command(name, "--help")
    printed = capsys.readouterr().out
    assert printed.startswith(f"usage: soft-tendon {name} ")
    names = {*kind.model_fields} - {"entrants"}
    if "options" in names:
        names |= {"scene", "fidelity", "target", "set"}
        names.remove("options")
    _, _, listing = printed.split("\n\n", 2)
    for field in names:
        name = field.replace("_", "[-_]")
        # the option or the argument, and words in lower case before the next option
        entry = rf"(--{name}(, --no-{name})?|\b{name.upper()})\b((?! --).)* [a-z]\S* \S+"
        assert re.search(entry, " ".join(listing.split())), field


def test_names_of_commands_are_kept():
    with pytest.raises(ValueError, match="the name 'train' of the command of .* is taken"):
        register("command", "train", print, description="another")


@pytest.mark.slow  # a process
def test_help_and_the_package_load_nothing_that_extras_bring():
    code = "import sys, soft_tendon_env\nfrom soft_tendon_env.cli.main import main\n"
    code += (
        "for name in sys.argv[1:]:\n    try:\n        main([name, '--help'])\n    except"
        " SystemExit:\n        pass\n"
    )
    code += f"print(sorted(set(sys.modules) & set({HEAVY!r})), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *COMMANDS], capture_output=True, text=True)
    assert done.stderr.splitlines() == ["[]"]
