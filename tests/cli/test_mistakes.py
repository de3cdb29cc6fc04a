"""Mistakes of every command: a message that names the option, the file or the key, with what is
allowed, before anything is written."""

import errno
import shutil
from concurrent.futures.process import BrokenProcessPool

import pytest

from soft_tendon_env.cli import errors

TEXTS = {
    "key.toml": "episods = 3",
    "markers.toml": "[markers.tip]\narc_length = 0.3\n",
    "holds.csv": (
        "hold,tension_0,tension_1,tension_2,tip_x,tip_y,tip_z\n"
        "a,1,0,0,0.29,0.03,0\n"
        "b,0,1,0,0.29,-0.02,0.02\n"
    ),
}
"""Files of the folder that commands are called in."""
IDENTIFY = (
    "identify",
    "three_tendon",
    "holds.csv",
    "--out",
    ".",
    "--markers",
    "markers.toml",
    "--parameters",
)
AGENTS = "agent, apg, apg_filtered, apg_obstacles, apg_water, dagger, ppo, sac"
OPTIONS = [
    ("trian", "'trian' is no command: did you mean 'train'?"),
    ("evaluate", "Missing from soft-tendon evaluate: POLICY a controller's name"),
    ("evaluate tracking --episode 3", "Perhaps you meant: --episodes INT number of episodes"),
    ("evaluate tracking feedforward", "Unrecognized options: feedforward"),
    ("evaluate tracking --episodes", "Missing value for argument '"),
    (
        "evaluate tracking --episodes 300",
        "--episodes is 300: it should be less than or equal to 20",
    ),
    ("evaluate trackin", "a controller of TipPose; did you mean 'tracking'? valid: "),
    (
        "evaluate MPC",
        "policy is 'MPC': it should be 'predictive', this package's model-predictive control",
    ),
    ("evaluate filtered:mpc", "policy is 'filtered:mpc': it should be 'filtered:predictive'"),
    (
        "train ppo_tip_pose --steps 1000",
        "--steps is no option of train: for a key of that name write --set steps=1000",
    ),
    ("evaluate tracking --control-period=0.01", "write --set control_period=0.01"),
    (
        "evaluate mine",
        "to use one of your own, import its module first (on the command line: --import MODULE)",
    ),
    ("arena --config /dev/zero", "/dev/zero: cannot be read: it should be a regular file"),
    ("evaluate tracking --episodes three", "--episodes is 'three': it should be a valid integer"),
    (
        "evaluate tracking --scene three_tendon --set scene=paper",
        "--set has scene, and so has --scene: give it once",
    ),
    (
        "evaluate tracking --set control_period=20ms",
        "control_period is '20ms': it should be a valid number, in SI units and without",
    ),
    ("train ppo_tip_pose --engine rlib", "--engine is 'rlib': it should be 'sb3' or 'rllib'"),
    (
        "evaluate tracking --fidelity fast --fidelity fine",
        "--fidelity is given twice: give it once",
    ),
    ("evaluate tracking --set fidelity=quick", "--set: fidelity is 'quick': it should be"),
    ("evaluate tracking --set preview", "--set 'preview' should be KEY=VALUE"),
    (
        "arena --config key.toml",
        "key.toml: episods is an unknown key (given 3): did you mean 'episodes'?",
    ),
    (
        "compare --policies feedforward --task TipPose --cluster 127.0.0.1:1",
        "Ray",
    ),  # is not there, or does not answer
    (
        "run feedforward --seconds 0.01",
        "seconds is 0.01: it should be at least one control period, 0.02 s, and skip",
    ),
    (
        "train ppo_tip_pos",
        "neither the path of a .toml file nor a training that ships: did you mean 'ppo_tip_pose'?",
    ),
    ("train ppo_tip_pose --runners 3", "--runners is for --engine rllib"),
    (
        "sweep ppo_tip_pose other/ppo_tip_pose.toml",
        "has two files ppo_tip_pose.toml, whose runs would share a folder",
    ),
    ("reproduce-paper --seconds 11", "--seconds is 11: it should be less than or equal to 10"),
    ("effects gravty", "name is 'gravty': did you mean 'gravity'?"),
    (
        "effects own_drag",
        "to use one of your own, import its module first (on the command line: --import MODULE)",
    ),
    (
        "fields three_tendon --within 1",
        "--within is 1: it should be a positive length with its unit",
    ),
    (
        "fields three_tendon --out fields.txt",
        "--out is fields.txt: it should be the path of a .json file, such as",
    ),
    (
        "accuracy three_tendon --set segments.0.radios=1",
        "--set: segments[0].radios is an unknown key",
    ),
    (
        " ".join((*IDENTIFY, "segments.*.dens")),
        "segments.*.dens is no number of the scene: did you mean 'segments.*.density'?",
    ),
    (
        "export three_tendon",
        f"three_tendon should be the folder of an agent, or {AGENTS}, which ship; for a",
    ),
    ("export agent --mjcf", "'agent': is neither the path of a .toml file nor a scene that ships"),
    ("export agent --links 3", "--links cannot be given without --mjcf"),
    ("tune predictive --trials 0", "--trials is 0: it should be greater than or equal to 1"),
    (
        "--import no_such_module demo",
        (
            "--import names 'no_such_module': it should be a module, in this folder or on"
            " PYTHONPATH; No"
        ),
    ),
]
FILES = [
    (
        "train {config} --set options.scene=nowhere",
        "options.scene cannot be used: 'nowhere': is neither the path",
    ),
    (
        "train {config} --set seconds=1e12",
        "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s",
    ),
    ("train {config} --set arms=2 arms=3", "--set has arms, which is given twice"),
    (
        "train {config} --set hyperparameters.n_steps.x=3",
        "small.toml, changed: hyperparameters.n_steps.x cannot be set",
    ),
    (
        "evaluate {best} --set action=tension",
        "trained with action = 'increment', this environment has",
    ),
    (
        "evaluate {best} --scene paper",
        "was trained on an arm with other segments and tendons (scene 'three_tendon')",
    ),
    (
        "train {config} --set hyperparameters.n_steps=0",
        "hyperparameters.n_steps is 0: it should be a number at least 1",
    ),
    ("evaluate {folder}", "it should be the folder of an agent (of a training: {best})"),
    ("arena --config {model}", "model.zip: is not valid TOML"),
]
DAMAGES = [
    lambda path: path.write_bytes(path.read_bytes()[:-20]),
    lambda path: path.write_bytes(b"[]"),
    lambda path: path.unlink(),
]


@pytest.mark.parametrize(("arguments", "said"), OPTIONS)
def test_options(refused, tmp_path, arguments, said):
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    assert said in refused(*arguments.split())


@pytest.mark.parametrize(("arguments", "said"), FILES)
def test_files_and_what_stands_in_them(refused, config, finished, arguments, said):
    known = {
        "config": config,
        "folder": finished,
        "best": finished / "best",
        "model": finished / "last" / "model.zip",
    }
    assert said.format(**known) in refused(
        *(argument.format(**known) for argument in arguments.split()), "--out", "out"
    )


@pytest.mark.parametrize(
    ("arguments", "missing"), [("train ppo_tip_pose", "agents"), ("demo", "pictures,recording")]
)
def test_missing_extras_come_with_the_command_that_installs_them(
    refused, monkeypatch, arguments, missing
):
    monkeypatch.setattr(errors, "find_spec", lambda module: None)
    assert f'pip install "soft_tendon_env[{missing}]"' in refused(*arguments.split())


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize(
    ("place", "name", "arguments"),
    [
        ("last", "model.zip", "train {config} --resume --set steps=256 --out {run}"),
        ("best", "weights.npz", "evaluate {run}/best --episodes 1 --out {run}/out"),
        ("best", "config.json", "record {run}/best --out {run}/out/a.rrd"),
    ],
)
def test_damaged_checkpoints_and_agents_are_refused(
    refused, config, finished, tmp_path, damage, place, name, arguments
):
    run = tmp_path / "run"
    damage(shutil.copytree(finished, run) / place / name)
    said = refused(*arguments.format(config=config, run=run).split())
    assert str(run / place) in said
    assert name in said


def test_an_agent_does_not_run_an_arm_that_is_none_of_its_training(refused, finished):
    arm = ("--set", 'scene."segments.0.young_modulus"=6e5', "scene.scene=three_tendon")
    said = refused("run", finished / "best", *arm)
    assert "was not trained for this arm: segments.0.young_modulus is 600000, in its" in said
    assert "--beyond-training" in said
    other = refused("evaluate", finished / "best", "--scene", "paper", "--out", "out")
    assert "it has 10 tendons, in its training 3;" in other
    assert "soft-tendon train ppo_tip_pose --set options.scene=paper" in other


@pytest.mark.parametrize(
    ("place", "reason"), [("file", "File exists"), ("file/new", "Not a directory")]
)
def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(
    refused, tmp_path, place, reason
):
    (tmp_path / "file").touch()
    said = refused(
        *[
            "evaluate",
            "feedforward",
            "--scene",
            "three_tendon",
            "--fidelity",
            "fast",
            "--errors",
            "nominal",
            "--out",
        ],
        tmp_path / place,
    )
    assert (
        f"soft-tendon evaluate: error: --out is {tmp_path / place}: it should be a folder that can"
        in said
    )
    assert reason in said


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device", "out/a.png"),
            1,
            "a.py: error: out/a.png: No space left on device",
        ),
        (
            MemoryError("Unable to allocate 70 TiB"),
            1,
            "a.py: error: there is too little memory: Unable to allocate 70 TiB",
        ),
        (
            BrokenProcessPool("died"),
            1,
            "a.py: error: a process of --workers was killed: it may have had too little memory",
        ),
        (errors.Mistake("one\ntwo"), 2, "a.py: error: one\na.py: error: two"),
        (KeyboardInterrupt(), 130, "stopped: begin again"),
    ],
)
def test_what_ends_a_command_is_said(capsys, error, status, said):
    with pytest.raises(SystemExit) as exit, errors.exit_in_one_line("a.py", "stopped: begin again"):
        raise error
    code = exit.value.code
    assert (code == status) if isinstance(code, int) else status == 1
    assert (code if isinstance(code, str) else capsys.readouterr().err.strip()).startswith(said)


def test_what_is_wrong_with_a_command_is_not_hidden():
    with (
        pytest.raises(ValueError, match="a mistake of ours"),
        errors.exit_in_one_line("a.py", "stopped"),
    ):
        raise ValueError("a mistake of ours")
