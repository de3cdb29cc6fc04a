"""Mistakes of every command: one line that names the option, the file or the key, with what is allowed, before anything is written."""

import pytest

from soft_tendon_env.cli import errors

TEXTS = {
    "two.csv": "a,b\n1,2\n",
    "docs.md": "no markers",
    "key.toml": "episods = 3",
    "own.toml": 'policies = ["feedforward"]\noptions = {scene = "three_tendon", fidelity = "fast"}',
}
"""Files of the folder that commands are called in."""
OPTIONS = [
    (("trian",), "'trian' is no command: did you mean 'train'?"),
    (("evaluate",), "the following arguments are required: policy"),
    (("evaluate", "tracking", "--episode", "3"), "--episode is no option: did you mean '--episodes'? valid: --all, --cluster, "),
    (("evaluate", "tracking", "feedforward"), "unrecognized arguments: feedforward"),
    (("evaluate", "tracking", "--episodes"), "argument --episodes: expected one argument"),
    (("evaluate", "tracking", "--episodes", "300"), "--episodes is 300: it should be at most 20, or seeds should be given in its place"),
    (("evaluate", "tracking", "--task", "Tip"), "--task is 'Tip': it should be a task: did you mean 'TipPose'? valid: Reach, "),
    (("evaluate", "tracking", "--fidelity", "fast", "--fidelity", "fine"), "--fidelity is given twice, with fast and fine"),
    (("evaluate", "tracking", "--set", "fidelity=fast", "--fidelity", "fine"), "--set has fidelity, and so has --fidelity: give it once"),
    (("evaluate", "tracking", "--options", '{"fidelity": "quick"}'), "--options: fidelity is 'quick': it should be"),
    (("evaluate", "tracking", "--options", "{"), "--options '{' is not JSON"),
    (("evaluate", "tracking", "--errors", "noise,nois"), "names 'nois': did you mean 'noise'?"),
    (("evaluate", "tracking", "--errors", "stiffness+20%,stiffness-20%"), "in which stiffness is said twice"),
    (("evaluate", "tracking", "--episodes", "3", "--seeds", "1", "2"), "--episodes is 3: it should be 2, as there are seeds"),
    (("evaluate", "tracking", "--scene", "no_scene"), "'no_scene': is neither the path of a .toml file nor a scene that ships"),
    (("evaluate", "tracking", "--set", "randomize.pay=0.1"), "--set: randomize.pay is an unknown key (given 0.1): did you mean 'payload'?"),
    (("evaluate", "tracking", "--set", "preview"), "--set 'preview' should be KEY=VALUE"),
    (("evaluate", "nothing.zip"), "there is no file nothing.zip"),
    (("compare", "--policies", "trackin"), "did you mean 'tracking'?"),
    (("compare", "--config", "key.toml"), "key.toml: episods is an unknown key (given 3): did you mean 'episodes'?"),
    (("compare", "--config", "own.toml", "--task", "TipPose", "--cluster", "127.0.0.1:1"), "Ray"),  # is not there, or does not answer
    (("compare", "--config", "own.toml", "--write-docs", "docs.md"), "docs.md should have the lines <!-- compare Reach --> and "),
    (("record", "tracking", "--target", "square"), "--target: type is 'square': valid: circle, hold, ramp, random, steps"),
    (("export", "tracking"), "agent is 'tracking': it should be the folder or the .zip file of an agent, or agent, ppo, sac, dagger"),
    (("export", "agent", "--out", "agent.pt"), "--out is agent.pt: it should be the path of an .onnx file, such as agent.onnx"),
    (("run", "feedforward", "--seconds", "0.01"), "seconds is 0.01: it should be at least one control period, 0.02 s, and skip"),
    (("demo", "--agent", "tracking"), "--agent is 'tracking': it should be the folder or the .zip file of an agent"),
    (("train", "ppo_tip_pos"), "neither the path of a .toml file nor a training that ships: did you mean 'ppo_tip_pose'?"),
    (("train", "ppo_tip_pose", "--runners", "3"), "--runners is for --engine rllib"),
    (("sweep", "ppo_tip_pose", "other/ppo_tip_pose.toml"), "another configuration is called ppo_tip_pose too"),
    (("reproduce-paper", "--figures", "7"), "--figures[0] is '7': it should be 2, 3, 4, 5 or 6"),
    (("scenes", "papr"), "'papr': is neither the path of a .toml file nor a scene that ships: did you mean 'paper'?"),
    (("effects", "gravty"), "name is 'gravty': did you mean 'gravity'?"),
    (("fields", "three_tendon", "--coordinates", "2"), "--coordinates is 2: the arm has 3 without passive fields, 27 with all"),
    (("fields", "three_tendon", "--within", "1"), "--within is 1.0: it should be a positive length with its unit"),
    (("fields", "three_tendon", "--out", "fields.txt"), "--out is fields.txt: it should be the path of a .json file, such as"),
    (("accuracy", "three_tendon", "--check", "50"), "--check counts how often the setting for --within stays within it"),
    (("accuracy", "three_tendon", "--motion", "mild"), "--motion[0] is 'mild'"),
    (("accuracy", "three_tendon", "--input", "two.csv"), "should have a line of names, then rows of 3 finite tensions [N]"),
]
FILES = [
    ("train", ("{config}", "--set", "options.scene=nowhere"), "options.scene cannot be used: 'nowhere': is neither the path"),
    ("train", ("{config}", "--set", "seconds=1e12"), "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s"),
    ("train", ("{config}", "--set", "evaluation.skip=5"), "it should be at least one control period, 0.02 s, and skip, which is 5"),
    ("train", ("{config}", "--set", "arms=1000000000", "--set", "steps=9"), "arms is 1000000000: it should be less than or equal to"),
    ("train", ("{config}", "--set", "learning_rate=[1, -1]"), "learning_rate[1] is -1: it should be greater than or equal to 0"),
    ("train", ("{config}", "--set", "hyperparameters.n_steps=0"), "PPO cannot be made of these hyperparameters: "),
    ("train", ("{config}", "--set", "hyperparameters.n_steps.x=3"), "small.toml, changed: hyperparameters.n_steps.x cannot be set"),
    ("train", ("{config}", "--set", "arms=2", "steps=300", "--set", "arms=3"), "--set has arms, which is given twice"),
    ("train", ("none.toml",), "none.toml: cannot be read: No such file or directory"),
    ("sweep", ("{config}", "--set", "seed=3"), "--set has seed: --seeds and --first-seed say which there are"),
    ("evaluate", ("{best}", "--seconds", "1e12"), "seconds is 1e+12: it should be at most 1000000 control periods, 20000 s"),
    ("evaluate", ("{best}", "--options", '{{"action": "increment"}}'), "trained with action = 'tension', this environment has"),
    ("evaluate", ("{best}", "--scene", "paper"), "was trained on an arm with other segments (scene 'three_tendon')"),
    ("evaluate", ("{folder}",), "a folder: it should be the folder of an agent, such as {best}, a .zip file"),
    ("evaluate", ("filtered:",), "policy is 'filtered:': what stands behind 'filtered:' should be a controller of TipPose"),
    ("compare", ("--config", "{model}"), "model.zip: is not valid TOML"),
]


@pytest.mark.cases("arguments, said", OPTIONS)
def test_options(refused, tmp_path, arguments, said):
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    assert said in refused(*arguments)


@pytest.mark.cases("script, arguments, said", FILES)
def test_files_and_what_stands_in_them(refused, config, finished, script, arguments, said):
    known = {"config": config, "folder": finished, "best": finished / "best", "model": finished / "last" / "model.zip"}
    assert said.format(**known) in refused(script, *(argument.format(**known) for argument in arguments), "--out", "out")


@pytest.mark.cases(
    "arguments, missing",
    [
        (("evaluate", "feedforward"), "pictures"),
        (("train", "ppo_tip_pose"), "agents"),
        (("sweep", "ppo_tip_pose"), "agents,pictures"),
        (("demo",), "agents,recording,pictures"),
        (("export", "agent"), "export"),
    ],
)
def test_missing_extras_come_with_the_command_that_installs_them(refused, monkeypatch, arguments, missing):
    monkeypatch.setattr(errors, "find_spec", lambda module: None)
    found = refused(*arguments).partition('pip install "soft_tendon_env[')[2].removesuffix(']"')
    assert sorted(found.split(",")) == sorted(missing.split(","))
