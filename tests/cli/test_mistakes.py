"""Mistakes of every command: a message that names the option, the file or the key, with what is allowed, before anything is written."""

import errno
import shutil
from concurrent.futures.process import BrokenProcessPool

import pytest

from soft_tendon_env.cli import errors

TEXTS = {
    "two.csv": "a,b\n1,2\n",
    "docs.md": "no markers",
    "key.toml": "episods = 3",
    "own.toml": 'policies = ["feedforward"]\noptions = {scene = "three_tendon", fidelity = "fast"}',
    "markers.toml": "[markers.tip]\narc_length = 0.3\n",
    "holds.csv": "hold,tension_0,tension_1,tension_2,tip_x,tip_y,tip_z\na,1,0,0,0.29,0.03,0\nb,0,1,0,0.29,-0.02,0.02\n",
}
"""Files of the folder that commands are called in."""
OWN = ("compare", "--config", "own.toml")
IDENTIFY = ("identify", "three_tendon", "holds.csv", "--out", ".", "--markers", "markers.toml", "--parameters")
OPTIONS = [
    ("trian", "'trian' is no command: did you mean 'train'?"),
    ("evaluate", "Missing from soft-tendon evaluate: POLICY a controller's name"),
    ("evaluate tracking --episode 3", "Perhaps you meant: --episodes INT number of episodes"),
    ("evaluate tracking feedforward", "Unrecognized options: feedforward"),
    ("evaluate tracking --episodes", "Missing value for argument '"),
    ("evaluate tracking --episodes many", "Error parsing --episodes: invalid literal for int() with base 10: 'many'"),
    ("evaluate tracking --episodes 300", "--episodes is 300: it should be at most 20, or seeds should be given in its place"),
    ("evaluate tracking --workers 0", "--workers is 0: it should be greater than or equal to 1"),
    ("evaluate tracking --task Tip", "--task is 'Tip': it should be a task: did you mean 'TipPose'? valid: Reach, "),
    ("evaluate tracking --fidelity fast --fidelity fine", "--fidelity is given twice: give it once"),
    ("evaluate tracking --set a=1 --set b=1", "--set is given twice: give it once, with all its values behind it"),
    ("evaluate tracking --set fidelity=fast --fidelity fine", "--set has fidelity, and so has --fidelity: give it once"),
    ("evaluate tracking --set fidelity=quick", "--set: fidelity is 'quick': it should be"),
    ("evaluate tracking --fidelity quick", "--fidelity is 'quick': it should be"),
    ("evaluate tracking --set randomize.pay=0.1", "--set: randomize.pay is an unknown key (given 0.1): did you mean 'payload'?"),
    ("evaluate tracking --set preview", "--set 'preview' should be KEY=VALUE"),
    ("evaluate tracking --errors noise,nois", "names 'nois': did you mean 'noise'?"),
    ("evaluate tracking --errors stiffness+20%,stiffness-20%", "in which stiffness is said twice"),
    ("evaluate tracking --episodes 3 --seeds 1 2", "--episodes is 3: it should be 2, as there are seeds"),
    ("evaluate tracking --scene no_scene", "'no_scene': is neither the path of a .toml file nor a scene that ships"),
    ("evaluate nothing.zip", "there is no file nothing.zip"),
    ("compare --policies trackin", "did you mean 'tracking'?"),
    ("compare --config key.toml", "key.toml: episods is an unknown key (given 3): did you mean 'episodes'?"),
    ("compare --config own.toml --task TipPose --cluster 127.0.0.1:1", "Ray"),  # is not there, or does not answer
    ("compare --config own.toml --write-docs docs.md", "docs.md should have the lines <!-- compare Reach --> and "),
    ("run feedforward --seconds 0.01", "seconds is 0.01: it should be at least one control period, 0.02 s, and skip"),
    ("run feedforward --robot-options port", "'port' should be KEY=VALUE"),
    ("demo --agent tracking", "--agent is 'tracking': it should be the folder or the .zip file of an agent"),
    ("train ppo_tip_pos", "neither the path of a .toml file nor a training that ships: did you mean 'ppo_tip_pose'?"),
    ("train ppo_tip_pose --runners 3", "--runners is for --engine rllib"),
    ("train ppo_tip_pose --engine sb4", "invalid choice 'sb4' for argument '--engine'. Expected one of ('sb3', 'rllib')"),
    ("train none.toml", "none.toml: cannot be read: No such file or directory"),
    ("sweep ppo_tip_pose other/ppo_tip_pose.toml", "another configuration is called ppo_tip_pose too"),
    ("sweep ppo_tip_pose --set seed=3", "--set has seed: --seeds and --first-seed say which there are"),
    ("reproduce-paper --figures 7", "invalid choice '7' for argument '--figures'"),
    ("reproduce-paper --seconds 2 --write-docs docs.md", "--write-docs needs all figures and 10 seconds"),
    ("scenes papr", "'papr': is neither the path of a .toml file nor a scene that ships: did you mean 'paper'?"),
    ("effects gravty", "name is 'gravty': did you mean 'gravity'?"),
    ("fields three_tendon --within 1", "--within is '1': it should be a positive length with its unit"),
    ("fields three_tendon --out fields.txt", "--out is fields.txt: it should be the path of a .json file, such as"),
    ("accuracy three_tendon --motion mild", "invalid choice 'mild' for argument '--motion'"),
    ("accuracy three_tendon --input two.csv", "two.csv should have shape (any, 3), not (1, 2)"),
    ("accuracy three_tendon --input none.csv", "there is no file none.csv"),
    ("accuracy three_tendon --set segments.0.radios=1", "--set: segments[0].radios is an unknown key"),
    ("identify three_tendon holds.csv --markers markers.toml", "Missing from soft-tendon identify: --parameters"),
    (" ".join((*IDENTIFY, "segments.*.dens")), "segments.*.dens is no number of the scene: did you mean 'segments.*.density'?"),
    (" ".join((*IDENTIFY, "segments.*.density", "--noise", "0.5")), "--noise is '0.5': it should be a positive length with its unit"),
    ("tune predictive --trials 0", "--trials is 0: it should be greater than or equal to 1"),
    ("--import no_such_module demo", "--import names 'no_such_module': it should be a module, in this folder or on PYTHONPATH; No"),
]
FILES = [
    ("train {config} --set options.scene=nowhere", "options.scene cannot be used: 'nowhere': is neither the path"),
    ("train {config} --set seconds=1e12", "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s"),
    ("train {config} --set arms=2 arms=3", "--set has arms, which is given twice"),
    ("train {config} --set hyperparameters.n_steps.x=3", "small.toml, changed: hyperparameters.n_steps.x cannot be set"),
    ("evaluate {best} --set action=increment", "trained with action = 'tension', this environment has"),
    ("evaluate {best} --scene paper", "was trained on an arm with other segments (scene 'three_tendon')"),
    ("train {config} --set hyperparameters.n_steps=0", "hyperparameters.n_steps is 0: it should be a number at least 1"),
    ("evaluate {folder}", "a folder: it should be the folder of an agent, such as {best}, a .zip file"),
    ("compare --config {model}", "model.zip: is not valid TOML"),
]


@pytest.mark.cases("arguments, said", OPTIONS)
def test_options(refused, tmp_path, arguments, said):
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    assert said in refused(*arguments.split())


@pytest.mark.cases("arguments, said", FILES)
def test_files_and_what_stands_in_them(refused, config, finished, arguments, said):
    known = {"config": config, "folder": finished, "best": finished / "best", "model": finished / "last" / "model.zip"}
    assert said.format(**known) in refused(*(argument.format(**known) for argument in arguments.split()), "--out", "out")


@pytest.mark.cases(
    "arguments, missing",
    [
        ("evaluate tracking", "pictures"),
        ("train ppo_tip_pose", "agents"),
        ("demo", "agents,pictures,recording"),
        ("export agent", "export"),
    ],
)
def test_missing_extras_come_with_the_command_that_installs_them(refused, monkeypatch, arguments, missing):
    monkeypatch.setattr(errors, "find_spec", lambda module: None)
    assert f'pip install "soft_tendon_env[{missing}]"' in refused(*arguments.split())


DAMAGES = [lambda path: path.write_bytes(path.read_bytes()[:-20]), lambda path: path.write_bytes(b"[]"), lambda path: path.unlink()]


@pytest.mark.cases("damage", DAMAGES)
@pytest.mark.cases(
    "place, name, arguments",
    [
        ("last", "model.zip", "train {config} --resume --set steps=256 --out {run}"),
        ("best", "weights.pt", "evaluate {run}/best --episodes 1 --out {run}/out"),
        ("best", "config.json", "record {run}/best --out {run}/out/a.rrd"),
    ],
)
def test_damaged_checkpoints_and_agents_are_refused(refused, config, finished, tmp_path, damage, place, name, arguments):
    run = tmp_path / "run"
    shutil.rmtree(run, ignore_errors=True)
    damage(shutil.copytree(finished, run) / place / name)
    said = refused(*arguments.format(config=config, run=run).split())
    assert str(run / place) in said and name in said


@pytest.mark.cases("place, reason", [("file", "File exists"), ("file/new", "Not a directory"), ("full", "No space left on device")])
def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(refused, monkeypatch, tmp_path, place, reason):
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir(exist_ok=True)
    with monkeypatch.context() as patched:
        if place == "full":
            patched.setattr(errors.tempfile, "TemporaryFile", lambda dir: open("/dev/full", "wb"))
        said = refused(*"evaluate feedforward --scene three_tendon --fidelity fast --errors nominal --out".split(), tmp_path / place)
    assert f"soft-tendon evaluate: error: --out is {tmp_path / place}: it should be a folder that can" in said and reason in said


@pytest.mark.cases(
    "error, status, said",
    [
        (OSError(errno.ENOSPC, "No space left on device", "out/a.png"), 1, "a.py: error: out/a.png: No space left on device"),
        (MemoryError("Unable to allocate 70 TiB"), 1, "a.py: error: there is too little memory: Unable to allocate 70 TiB"),
        (BrokenProcessPool("died"), 1, "a.py: error: a process of --workers was killed: it may have had too little memory"),
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
    with pytest.raises(ValueError, match="a mistake of ours"), errors.exit_in_one_line("a.py", "stopped"):
        raise ValueError("a mistake of ours")
