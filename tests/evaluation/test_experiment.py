"""Experiments: what was played is kept, and played again only where something has changed."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from soft_tendon_env.evaluation import experiment
from soft_tendon_env.evaluation.experiment import Cell, Experiment, code_digest, measure
from soft_tendon_env.scene.file import load_scene, save_scene

ARM = {"scene": "three_tendon", "fidelity": "fast"}
CELL = Cell("TipPose", "feedforward", ARM, (3, 4), 0.2, 0.1)


def less_time(scores):
    return [vars(replace(score, action_time=0.0)) for score in scores]


def test_what_is_there_is_not_played_again_and_scores_survive_their_file(tmp_path, monkeypatch):
    """NaN too, of an episode that diverged before any error counted."""
    wild = {
        "scene": "three_tendon",
        "integrator.max_halvings": 0,
        "integrator.step": 0.02,
        "integrator.tolerance": 1e-10,
    }
    ill = CELL._replace(options={"scene": wild}, seconds=2.0, skip=1.9)
    Experiment({"one": CELL, "ill": ill}, tmp_path).play("first", 1)
    whole = Experiment(
        {"one": CELL, "alike": CELL, "ill": ill, "other": CELL._replace(seeds=(5,))}, tmp_path
    )
    assert whole.missing() == ["other"]
    for label in ("alike", "ill"):
        np.testing.assert_equal(
            less_time(whole.scores(label)), less_time(measure(whole.cells[label]))
        )
    assert whole.scores("ill")[0].diverged
    assert np.isnan(whole.scores("ill")[0].errors["position_error"].rms)
    for path in tmp_path.glob("*.json"):
        path.write_text("{}")
    with pytest.raises(ValueError, match="is no result of an experiment: take it away"):
        whole.scores("one")


def test_each_part_has_a_progress_bar_of_its_own_name(tmp_path, monkeypatch):
    labels = []

    def remember(call, runs, workers, label, **options):
        labels.append(label)

    monkeypatch.setattr(experiment, "run_all", remember)
    Experiment({"one": CELL}, tmp_path).play("circle", 1)
    assert labels == ["circle: times per action", "circle: episodes"]


def test_other_code_is_another_result(tmp_path, monkeypatch):
    """Of modules that are not installed too, such as one that registers a controller."""
    before = code_digest()
    module = type(sys)("own_controllers")
    module.__file__ = str(tmp_path / "own_controllers.py")
    monkeypatch.setitem(sys.modules, "own_controllers", module)
    found = set()
    for text in ("GAIN = 1.0\n", "GAIN = 2.0\n"):
        (tmp_path / "own_controllers.py").write_text(text)
        found.add(code_digest())
    monkeypatch.setattr(experiment, "sources_digest", lambda *patterns: "of other sources")
    assert len({before, *found, code_digest()}) == 4


def test_a_key_is_of_all_that_a_result_depends_on(tmp_path):
    file = tmp_path / "arm.toml"
    options = {**ARM, "scene": str(file)}

    def key(text=None, **changes):
        if text is not None:
            file.write_text(text)
        return CELL._replace(**{"options": options, **changes}).key("code")

    scene = load_scene("three_tendon")
    save_scene(scene, file)
    first = key()
    assert key() == first
    assert [*experiment._files_in({"passive": [{"file": str(file)}, "paper", ""], "order": 1})] == [
        str(file)
    ]
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
        key(file.read_text() + "\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.8]\n"),
    ]
    assert len({first, *different}) == 1 + len(different)
