"""Experiments: what was played is kept, and played again only where something that it depends on has changed."""

import sys
import sysconfig
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import evaluate, experiment
from soft_tendon_env.evaluation.experiment import Cell, Experiment, code_version, measure
from soft_tendon_env.policies.load import load_policy
from soft_tendon_env.scene.file import load_scene, save_scene

ARM = {"scene": "three_tendon", "fidelity": "fast"}
CELL = Cell("TipPose", "feedforward", ARM, (3, 4), 0.2, 0.1)


def less_time(records):
    return [{key: value for key, value in record.items() if key != "action_time"} for record in records]


@pytest.mark.parametrize("changes", [{}, {"rows": False}, {"rows": False, "measured": "time"}], ids=["rows", "one by one", "alone"])
def test_records_are_those_of_the_episodes_one_by_one(changes):
    env = gym.make(IDS["TipPose"], max_episode_steps=10, **ARM)
    expected = [score.record() for score in evaluate(load_policy("feedforward", env), env, CELL.seeds, CELL.skip)]
    assert less_time(measure(CELL._replace(**changes))) == less_time(expected)


def test_what_is_there_is_not_played_again(tmp_path, monkeypatch):
    cells = {"one": CELL, "alike": CELL, "other": CELL._replace(seeds=(5,))}
    first = Experiment({"one": CELL}, tmp_path)
    first.play("first", 1)
    whole = Experiment(cells, tmp_path)
    assert whole.missing() == ["other"] and [*whole.played().cells] == ["one", "alike"]
    monkeypatch.setattr(experiment, "run_all", lambda call, runs, *rest, **named: [named["done"](k, []) for k, _ in enumerate(runs)])
    whole.play("the rest", 1)
    assert whole.missing() == [] and [score.seed for score in whole.scores("alike")] == [3, 4]
    next(tmp_path.glob("*.json")).write_text("{}")
    with pytest.raises(ValueError, match="is no result of an experiment: take it away"):
        whole.missing()


def test_scores_survive_their_file(tmp_path):
    """NaN and infinity too, which JSON has not: of an episode that diverged before any error counted."""
    wild = {"scene": "three_tendon", "integrator.max_halvings": 0, "integrator.step": 0.02, "integrator.tolerance": 1e-10}
    kept = Experiment({"well": CELL, "ill": CELL._replace(options={"scene": wild}, seconds=2.0, skip=1.9)}, tmp_path)
    kept.play("both", 1)
    for label, cell in kept.cells.items():
        np.testing.assert_equal(less_time(score.record() for score in kept.scores(label)), less_time(measure(cell)))
    assert kept.scores("ill")[0].diverged and np.isnan(kept.scores("ill")[0].errors["position_error"].rms)


def test_a_key_is_of_all_that_a_result_depends_on(tmp_path):
    own = tmp_path / "arm.toml"
    options = {**ARM, "scene": str(own)}

    def key(text=None, **changes):
        if text is not None:
            own.write_text(text)
        return CELL._replace(**{"options": options, **changes}).key("code")

    save_scene(load_scene("three_tendon"), own)
    first = key()
    assert key() == first
    different = [
        key(policy="tracking"),
        key(task="Shape"),
        key(seeds=(3,)),
        key(skip=0.0),
        key(measured="time", rows=False),
        key(options={**options, "target": "circle"}),
        key(options={**options, "randomize": {"payload": 0.1}}),
        key(told={"scene": "three_tendon"}),
        CELL._replace(options=options).key("other code"),
        key(own.read_text() + "\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.8]\n"),
    ]
    assert len({first, *different}) == 1 + len(different)


def test_the_code_is_that_of_the_package_and_of_modules_of_ones_own(tmp_path, monkeypatch):
    """Such as one that registers a controller."""
    before = code_version()
    own = tmp_path / "own_controllers.py"
    own.write_text("GAIN = 1.0\n")
    module = type(sys)("own_controllers")
    module.__file__ = str(own)
    monkeypatch.setitem(sys.modules, "own_controllers", module)
    first = code_version()
    own.write_text("GAIN = 2.0\n")
    assert len({before, first, second := code_version()}) == 3
    own.write_text('"""Gains."""\n\nGAIN = 2.0\n')
    documented = code_version()
    own.write_text('"""Gains of a controller\nof one\'s own [N/m]."""\n\nGAIN = 2.0\n')
    assert code_version() == documented != second, "other words of a docstring are no other code"
    monkeypatch.setattr(module, "__file__", str(Path(sysconfig.get_path("scripts")) / "soft-tendon"))
    assert code_version() == before, "the program that was started is no module of one's own"
    assert all((experiment.PACKAGE / name).exists() for name in experiment.SHOWS_ALONE if name.endswith("/"))


def test_files_that_a_scene_names_are_found(tmp_path):
    path = tmp_path / "arm.fields.json"
    path.write_text("{}")
    assert [*experiment._files_in({"passive": [{"file": str(path)}, "paper", ""], "order": 1})] == [str(path)]
