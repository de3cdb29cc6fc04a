"""Tuning: studies find least costs, go on, are pruned and shared; controllers and trainings leave
files that can be used."""

import csv
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from soft_tendon_env.cli.main import main
from soft_tendon_env.control.uncertainty import USUAL
from soft_tendon_env.evaluation import summaries
from soft_tendon_env.learning.config import config_names, find_config, read_training
from soft_tendon_env.policies import PolicyName
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.files import CONFIGS
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tuning.search import (
    ControllerSearch,
    Parameter,
    Search,
    TrainingSearch,
    read_search,
)
from soft_tendon_env.tuning.study import DONE, open_study, run_trial, tune

SPACE = {
    "a": {"low": 0.1, "high": 10.0, "log": True},
    "b": {"low": 1, "high": 100},
    "c": {"choices": [[1, 2], "x"]},
}
ARM = {"scene": "three_tendon", "fidelity": "fast"}
CONTROLLER = {
    "policy": "filtered:tracking@fast",
    "regimes": ["tip"],
    "episodes": 1,
    "seconds": 0.2,
    "skip": 0.0,
    "options": ARM,
    "search": {
        "settling_time": {"low": 0.1, "high": 0.8, "log": True},
        "estimator.force": {"low": 5e-4, "high": 2e-2},
    },
}
SHORT = {
    "steps": 128,
    "arms": 4,
    "seconds": 0.4,
    "options.scene": "three_tendon",
    "evaluation": {"every": 64, "episodes": 2, "skip": 0.2},
}
SHORT |= {"hyperparameters.batch_size": 128}
NETWORK = "hyperparameters.policy_kwargs.net_arch"
TRAINING = {
    "training": "ppo_tip_pose_nominal",
    "set": SHORT,
    "episodes": 2,
    "finalists": 1,
    "search": {
        "learning_rate[0]": {"low": 1e-4, "high": 1e-2, "log": True},
        NETWORK: {"choices": [[8], [16, 16]]},
    },
}


class Bowl(Search):
    """Costs that are least at a = 0.5, b = 30 and c = "x", reported twice."""

    search: dict[str, Parameter] = {name: Parameter(**table) for name, table in SPACE.items()}
    fails: bool = False

    def cost(self, values, folder, report):
        if self.fails:
            raise UserError("the weights are no longer finite")
        cost = (
            np.log(values["a"] / 0.5) ** 2 + np.log(values["b"] / 30.0) ** 2 + (values["c"] != "x")
        )
        for _ in range(2):
            report(cost)
        return cost

    def file(self, values):
        return dict(values)


def number_of(folder):
    """Number of the trial whose folder it is."""
    _, _, number = folder.name.partition("_")
    return int(number)


def done(search, folder):
    return open_study(search, folder).get_trials(states=DONE)


@pytest.mark.slow
def test_the_search_finds_the_least_cost(tmp_path):
    search = Bowl(trials=40)
    best = tune(search, tmp_path, workers=1)
    trials = done(search, tmp_path)
    found = best.user_attrs["values"]
    assert len(trials) == 40
    assert any(trial.state.name == "PRUNED" for trial in trials)
    assert found["c"] == "x"
    assert found["a"] == pytest.approx(0.5, rel=0.6)
    assert found["b"] == pytest.approx(30, rel=0.6)
    assert tomllib.loads((tmp_path / "best.toml").read_text()) == found
    rows = [
        float(row["cost"])
        for row in csv.DictReader((tmp_path / "trials.csv").read_text().splitlines())
        if row["state"] == "complete"
    ]
    assert min(rows) == best.value < trials[0].value


@pytest.mark.slow
def test_a_study_goes_on_and_repeats_itself(tmp_path):
    """In two folders: another search is refused, and a machine that comes late finds nothing to
    do."""
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        for trials in (6, 12):
            tune(Bowl(trials=trials), tmp_path / name, workers=1)
    run_trial(Bowl(trials=12), tmp_path / "one")
    one = done(Bowl(trials=12), tmp_path / "one")
    other = done(Bowl(trials=12), tmp_path / "other")
    assert len(one) == len(other) == 12
    assert [trial.params for trial in one] == [trial.params for trial in other]
    with pytest.raises(
        ValueError, match="one has another search, seed was 0 and is 1: give another --out"
    ):
        open_study(Bowl(trials=6, seed=1), tmp_path / "one")
    with pytest.raises(
        UserError,
        match="none of 3 trials was successful, the first: .*the weights are no longer finite",
    ):
        tune(Bowl(trials=3, fails=True), tmp_path, workers=1)


@pytest.mark.parametrize(("finalists", "expected"), [(0, 3), (2, 4), (4, 1)])
def test_finals_on_other_seeds_tell_the_best(finalists, expected, monkeypatch, tmp_path, capsys):
    """Of trials and the values in use, which are the first one; without finals the least cost
    does."""
    of_trials = {0: 5.0, 1: 4.0, 2: 3.0, 3: 1.0, 4: 2.0}
    of_finals = {0: 3.0, 1: 0.5, 2: 2.0, 3: 4.0, 4: 1.0}
    played = []

    def cost(search, values, folder, report):
        number = number_of(folder)
        played.append((number, search._seeds))
        costs = of_trials if search._seeds[0] == 100 else of_finals
        return 1e-3 * costs[number]

    monkeypatch.setattr(ControllerSearch, "cost", cost)
    changes = {"trials": 5, "episodes": 4, "finalists": finalists}
    search = ControllerSearch(**CONTROLLER | changes)
    best = tune(search, tmp_path, workers=1)
    assert best.number == expected
    assert played[:5] == [(number, tuple(range(100, 104))) for number in range(5)]
    ranks = {0: [], 2: [3, 4, 0], 4: [3, 4, 2, 1, 0]}[finalists]
    assert played[5:] == [(number, tuple(range(104, 112))) for number in ranks]
    rows = csv.DictReader((tmp_path / "trials.csv").read_text().splitlines())
    costs = {int(row["trial"]): row["cost in the finals"] for row in rows}
    assert [number for number, text in costs.items() if text] == sorted(ranks)
    assert f"best: trial {expected}, {of_trials[expected]:.2f} mm" in capsys.readouterr().out


def test_no_other_trial_stands_for_the_values_in_use(monkeypatch, tmp_path):
    """Where theirs has failed."""
    played = []

    def cost(search, values, folder, report):
        number = number_of(folder)
        if search._seeds[0] != 100:
            played.append(number)
        elif number == 0:
            raise UserError("the values in use do not work")
        return 1e-3 * (10 - number)

    monkeypatch.setattr(ControllerSearch, "cost", cost)
    changes = {"trials": 4, "episodes": 4, "finalists": 2}
    tune(ControllerSearch(**CONTROLLER | changes), tmp_path, workers=1)
    assert played == [3, 2]


def test_settings_are_played_alone_and_together(monkeypatch, tmp_path):
    """The cost is the geometric mean of all."""
    played = []

    def play(search, make, task, options, seconds, skip):
        played.append(set(options["randomize"]) & {"latency", "payload", "stiffness"})
        return 4.0 ** len(played)

    monkeypatch.setattr(ControllerSearch, "play", play)
    together = [["latency", "load"]]
    changes = {"settings": ["nominal", "latency"], "together": together}
    search = ControllerSearch(**CONTROLLER | changes)
    cost = search.cost({}, tmp_path, lambda mean: None)
    assert played == [set(), {"latency"}, {"latency", "payload"}]
    assert cost == pytest.approx(4.0**2)


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (ControllerSearch, {"search": {}}, "search is {}: it should have at least 1 item"),
        (
            ControllerSearch,
            {"search": {"settling_time": {"low": 1.0}}},
            "settling_time is no range: it should have low < high",
        ),
        (
            ControllerSearch,
            {"search": {"settling_time": {"low": 1.0, "high": 0.5}}},
            "settling_time is no range: ",
        ),
        (
            ControllerSearch,
            {"search": {"settling_time": {"low": 0.0, "high": 0.5, "log": True}}},
            "settling_time is no range: ",
        ),
        (
            ControllerSearch,
            {"search": {"settling": {"low": 0.1, "high": 1.0}}},
            "search.settling is no parameter.*'settling_time'",
        ),
        (
            ControllerSearch,
            {"together": [["latency", "loads"]]},
            "together.*'loads'.*a setting",
        ),
        (
            ControllerSearch,
            {"episodes": 12, "finalists": 2},
            "finalists is 2, and `episodes` has all tuning seeds: it should be 0",
        ),
        (ControllerSearch, {"policy": "agent"}, "policy is 'agent': it should be a controller"),
        (
            TrainingSearch,
            {"training": "ppo"},
            "training is neither the path of a .toml file nor a training",
        ),
        (
            TrainingSearch,
            {"search": {"hyperparameters.gama": {"low": 0.1, "high": 0.9}}},
            "gama is an unknown key",
        ),
    ],
)
def test_mistakes_of_a_search_are_one_line(kind, changes, message):
    with pytest.raises(ConfigurationError) as caught:
        kind.parse(
            {**(CONTROLLER if kind is ControllerSearch else TRAINING), **changes}, "file.toml"
        )
    assert re.search(message, str(caught.value).splitlines()[0]), str(caught.value)


def test_a_search_begins_with_the_values_in_use(tmp_path):
    """As far as its ranges have them."""
    search = ControllerSearch(**CONTROLLER)
    in_use = {"settling_time": 0.2, "estimator.force": USUAL.force}
    assert search.first_values() == in_use
    narrow = {**CONTROLLER["search"], "settling_time": {"low": 0.5, "high": 0.8}}
    shorter = ControllerSearch(**{**CONTROLLER, "search": narrow})
    assert shorter.first_values() == {"estimator.force": USUAL.force}
    (waiting,) = open_study(search, tmp_path).trials
    assert waiting.system_attrs["fixed_params"] == in_use


@pytest.mark.parametrize(
    "table",
    [
        pytest.param(CONTROLLER, id="controller"),
        pytest.param(TRAINING, id="training", marks=pytest.mark.slow),
    ],
)
def test_both_are_tuned_from_the_command_line(table, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(summaries, "WORST", 10.0)  # it is far at the beginning
    file = tmp_path / "search.toml"
    out = tmp_path / "out"
    file.write_text(tomli_w.dumps(table))
    main(["tune", str(file), "--trials", "3", "--out", str(out)])
    printed = capsys.readouterr().out
    assert "3 trials: 3 complete, 0 pruned" in printed
    costs = [
        float(row["cost"]) for row in csv.DictReader((out / "trials.csv").read_text().splitlines())
    ]
    assert len({*costs}) > 1
    assert 0.0 < min(costs) < 10.0
    if table is CONTROLLER:
        best = PolicyName.parse(str(out / "best.toml"), "TipPose")
        assert best.parameters.keys() == CONTROLLER["search"].keys()
        assert best.estimator == "kalman"
    else:
        assert read_training(out / "best.toml").steps == 128
        assert (out / "trial_0" / "best" / "weights.npz").exists()
        assert not (Path(out) / "trial_0" / "last").exists(), "nothing goes on from it"
        in_finals = re.findall(r"trial \d: .*, in the finals (.*) mm", printed)
        assert 1 <= len(in_finals) <= 2
        assert all(float(cost) > 0.0 for cost in in_finals)
        # the agents of trials play, and none is trained again
        logs = [log.read_text() for log in out.glob("trial_*/final.log")]
        assert len(logs) == len(in_finals)
        assert not any("steps" in log for log in logs)
        assert "steps" in (out / "trial_0" / "trial.log").read_text(), "as a training says"


def test_the_values_in_use_are_those_that_the_search_has_found():
    """To the digits that the code has."""
    found = PolicyName.parse(str(CONFIGS / "tuned_predictive.toml"), "TipPose")
    search = read_search(find_config("predictive", "tune_"))
    assert found.parameters.keys() == search.search.keys()
    in_use = PolicyName.parse(search.policy, "TipPose").defaults
    for name, value in found.parameters.items():
        assert in_use[name] == pytest.approx(value, rel=5e-3), name


@pytest.mark.parametrize("name", config_names("tune_"))
def test_searches_that_ship_are_right(name):
    read_search(find_config(name, "tune_"))


def test_the_search_in_the_documentation_is_right(tmp_path):
    page = Path(__file__).parents[2] / "docs/how_to/train_at_scale.md"
    file = tmp_path / "search.toml"
    file.write_text(re.search(r"```toml\n(training.*?)```", page.read_text(), re.DOTALL)[1])
    read_search(file)
