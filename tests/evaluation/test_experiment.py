"""Experiments: what was played is kept, and played again only where something that it depends on has changed."""

import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import evaluate, experiment
from soft_tendon_env.evaluation.experiment import Cell, Experiment, code_digest, measure
from soft_tendon_env.policies.names import load_policy
from soft_tendon_env.scene.file import load_scene, save_scene

ARM = {"scene": "three_tendon", "fidelity": "fast"}
CELL = Cell("TipPose", "feedforward", ARM, (3, 4), 0.2, 0.1)


def less_time(scores):
    return [vars(replace(score, action_time=0.0)) for score in scores]


@pytest.mark.parametrize("changes", [{}, {"rows": False}], ids=["rows", "one by one"])
def test_scores_are_those_of_the_episodes_one_by_one(changes):
    env = gym.make(IDS["TipPose"], max_episode_steps=10, **ARM)
    expected = evaluate(load_policy("feedforward", env), env, CELL.seeds, CELL.skip)
    assert less_time(measure(CELL._replace(**changes))) == less_time(expected)


def test_what_is_there_is_not_played_again_and_scores_survive_their_file(tmp_path, monkeypatch):
    """NaN too, of an episode that diverged before any error counted."""
    wild = {"scene": "three_tendon", "integrator.max_halvings": 0, "integrator.step": 0.02, "integrator.tolerance": 1e-10}
    ill = CELL._replace(options={"scene": wild}, seconds=2.0, skip=1.9)
    Experiment({"one": CELL, "ill": ill}, tmp_path).play("first", 1)
    whole = Experiment({"one": CELL, "alike": CELL, "ill": ill, "other": CELL._replace(seeds=(5,))}, tmp_path)
    assert whole.missing() == ["other"]
    for label in ("alike", "ill"):
        np.testing.assert_equal(less_time(whole.scores(label)), less_time(measure(whole.cells[label])))
    assert whole.scores("ill")[0].diverged and np.isnan(whole.scores("ill")[0].errors["position_error"].rms)
    for path in tmp_path.glob("*.json"):
        path.write_text("{}")
    with pytest.raises(ValueError, match="is no result of an experiment: take it away"):
        whole.scores("one")


def test_other_code_is_another_result(tmp_path, monkeypatch):
    """Of modules that are not installed too, such as one that registers a controller."""
    before, module = code_digest(), type(sys)("own_controllers")
    module.__file__ = str(tmp_path / "own_controllers.py")
    monkeypatch.setitem(sys.modules, "own_controllers", module)
    found = set()
    for text in ("GAIN = 1.0\n", "GAIN = 2.0\n"):
        (tmp_path / "own_controllers.py").write_text(text)
        found.add(code_digest())
    monkeypatch.setattr(experiment, "sources_digest", lambda *patterns: "of other sources")
    assert len({before, *found, code_digest()}) == 4


def test_a_key_is_of_all_that_a_result_depends_on(tmp_path):
    own = tmp_path / "arm.toml"
    options = {**ARM, "scene": str(own)}

    def key(text=None, **changes):
        if text is not None:
            own.write_text(text)
        return CELL._replace(**{"options": options, **changes}).key("code")

    save_scene(load_scene("three_tendon"), own)
    first = key()
    assert key() == first and [*experiment._files_in({"passive": [{"file": str(own)}, "paper", ""], "order": 1})] == [str(own)]
    different = [
        key(policy="tracking"),
        key(task="Shape"),
        key(seeds=(3,)),
        key(skip=0.0),
        key(alone=True, rows=False),
        key(options={**options, "target": "circle"}),
        key(options={**options, "randomize": {"payload": 0.1}}),
        key(controller_scene={"scene": "three_tendon"}),
        CELL._replace(options=options).key("other code"),
        key(own.read_text() + "\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.8]\n"),
    ]
    assert len({first, *different}) == 1 + len(different)
