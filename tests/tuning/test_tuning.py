"""Tuning: studies find least costs, go on, are pruned and shared; controllers and trainings leave files that can be used."""

import csv
import re
import tomllib

import numpy as np
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import summaries
from soft_tendon_env.learning.config import config_names, find_config, read_training
from soft_tendon_env.policies import PolicyName
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tuning.controllers import ControllerSearch
from soft_tendon_env.tuning.search import Parameter, Search
from soft_tendon_env.tuning.study import Work, done, open_study, run_trial, values_of
from soft_tendon_env.tuning.trainings import TrainingSearch, row_cost
from soft_tendon_env.tuning.tune import compare, read_search, tune

SPACE = {"a": {"low": 0.1, "high": 10.0, "log": True}, "b": {"low": 1, "high": 100}, "c": {"choices": [[1, 2], "x"]}}
CONTROLLER = {
    "policy": "filtered:tracking@fast",
    "regimes": ["tip"],
    "episodes": 1,
    "seconds": 0.2,
    "skip": 0.0,
    "options": {"scene": "three_tendon", "fidelity": "fast"},
    "search": {"settling_time": {"low": 0.1, "high": 0.8, "log": True}, "estimator.force": {"low": 5e-4, "high": 2e-2}},
}
TRAINING = {
    "training": "ppo_tip_pose",
    "set": {
        "steps": 128,
        "arms": 4,
        "seconds": 0.4,
        "options.scene": "three_tendon",
        "evaluation": {"every": 64, "episodes": 2, "skip": 0.2},
    },
    "seeds": 1,
    "search": {
        "learning_rate": {"low": 1e-4, "high": 1e-2, "log": True},
        "hyperparameters.policy_kwargs.net_arch": {"choices": [[8], [16, 16]]},
    },
}


class Bowl(Search):
    """Costs that are least at a = 0.5, b = 30 and c = "x", reported twice; judged on three episodes."""

    search: dict[str, Parameter] = {name: Parameter(**table) for name, table in SPACE.items()}
    fails: bool = False

    @property
    def defaults(self):
        return {"a": 10.0, "b": 1, "c": [1, 2]}

    @property
    def reports(self):
        return 2

    def cost(self, values, folder, report):
        if self.fails:
            raise UserError("the weights are no longer finite")
        cost = np.log(values["a"] / 0.5) ** 2 + np.log(values["b"] / 30.0) ** 2 + (values["c"] != "x")
        for _ in range(2):
            report(cost)
        return cost

    def judge(self, values, folder):
        return np.full(3, self.cost({**self.defaults, **values}, folder, lambda cost: None)) + [0.0, 0.1, 0.2]

    def file(self, values):
        return dict(values)


@pytest.fixture
def work(tmp_path):
    """work(Bowl(trials=..., ...)): in a folder of its own."""
    return lambda search, **changes: Work(search, str(tmp_path / "study.log"), "bowl", tmp_path)._replace(**changes)


@pytest.mark.parametrize("pruner", ["none", "hyperband"])
def test_the_search_finds_the_least_cost(work, capsys, pruner):
    given = work(Bowl(trials=40, pruner=pruner))
    best = tune(given, workers=1)
    trials = done(open_study(given))
    assert len(trials) == 40 and trials[0].params == {"a": 10.0, "b": 1, "c": "[1, 2]"}, "defaults come first"
    found = values_of(given.search, best)
    assert found["c"] == "x" and found["a"] == pytest.approx(0.5, rel=0.6) and found["b"] == pytest.approx(30, rel=0.6)
    assert all(0.1 <= trial.params["a"] <= 10.0 and trial.params["b"] in range(1, 101) for trial in trials)
    assert any(trial.state.name == "PRUNED" for trial in trials) is (pruner != "none")
    assert tomllib.loads((given.folder / "best.toml").read_text()) == found
    rows = [*csv.DictReader(open(given.folder / "trials.csv"))]
    assert len(rows) == 40 and min(float(row["cost"]) for row in rows if row["state"] == "complete") == min(
        trial.value for trial in trials if trial.state.name == "COMPLETE"
    )
    comparison = compare(given, best, workers=1)
    assert comparison.interval.high < 0.0 and str(comparison).endswith(": better than the defaults")


def test_a_study_goes_on_is_shared_and_repeats_itself(work, tmp_path):
    """By two storages: the second half of the trials is as if nothing had been between; another search is refused."""
    database = f"sqlite:///{tmp_path}/study.db"
    for storage in (work(Bowl()).storage, database):
        tune(work(Bowl(trials=6), storage=storage), workers=1)
    tune(work(Bowl(trials=12), storage=database), workers=1)
    run_trial(work(Bowl(trials=12), storage=database))  # another machine's: there are enough
    tune(work(Bowl(trials=12)), workers=1)
    one, other = (done(open_study(work(Bowl(trials=12), storage=storage))) for storage in (work(Bowl()).storage, database))
    assert len(one) == len(other) == 12 and [trial.params for trial in one][:6] == [trial.params for trial in other][:6]
    assert len({str(trial.params) for trial in one}) == 12
    with pytest.raises(ValueError, match="has another search called bowl, seed was 0 and is 1: give another --out"):
        open_study(work(Bowl(trials=6, seed=1)))
    with pytest.raises(ValueError, match="storage is nothing://x: it cannot be opened"):
        open_study(work(Bowl(), storage="nothing://x"))


def test_trials_that_fail_are_told(work):
    with pytest.raises(UserError, match="none of 3 trials was successful, the first: the weights are no longer finite"):
        tune(work(Bowl(trials=3, fails=True))._replace(), workers=1)


def test_what_is_not_better_is_said(work):
    given = work(Bowl(trials=1))
    assert str(compare(given, tune(given, workers=1), workers=1)).endswith("difference +0 mm [+0, +0]: not better than the defaults")


@pytest.mark.cases(
    "kind, changes, message",
    [
        (ControllerSearch, {"search": {}}, "search is {}: it should have at least 1 item"),
        (ControllerSearch, {"search": {"settling_time": {"low": 1.0}}}, "search.settling_time.high is missing"),
        (ControllerSearch, {"search": {"settling_time": {"low": 1.0, "high": 0.5}}}, "high is 0.5: it should be above low, 1.0"),
        (ControllerSearch, {"search": {"settling_time": {"low": 0.0, "high": 0.5, "log": True}}}, "above 0 on a logarithmic scale"),
        (ControllerSearch, {"search": {"settling_time": {"low": 0.1, "choices": [1]}}}, "should have either low and high, or choices"),
        (ControllerSearch, {"search": {"settling": {"low": 0.1, "high": 1.0}}}, "search.settling is no parameter.*'settling_time'"),
        (ControllerSearch, {"parameters": {"estimator.forse": 1.0}}, "parameters.estimator.forse is no parameter.*'estimator.force'"),
        (ControllerSearch, {"policy": "agent"}, "policy is 'agent': it should be a controller"),
        (ControllerSearch, {"policy": "tracking", "search": {"damping": {"low": 1.0, "high": 2.0}}}, "regimes are for controllers with"),
        (ControllerSearch, {"policy": "trackin"}, "policy is 'trackin', no policy"),
        (ControllerSearch, {"settings": ["errors"]}, r"settings\[0\] is 'errors': it should be a setting: .*valid: actuation"),
        (ControllerSearch, {"options": {"fidelty": "fast"}}, "options.fidelty is an unknown key"),
        (TrainingSearch, {"training": "ppo"}, "ppo.* is neither the path of a .toml file nor a training"),
        (TrainingSearch, {"set": {"stepz": 3}}, "set does not fit ppo_tip_pose: stepz is an unknown key"),
        (TrainingSearch, {"search": {"learning_rate": {"low": 0.1, "high": 2.0}}}, "search.learning_rate.high is 2.0: learning_rate"),
        (TrainingSearch, {"search": {"hyperparameters.gama": {"low": 0.1, "high": 0.5}}}, "gama.low is 0.1: hyperparameters.gama is an"),
    ],
)
def test_mistakes_of_a_search_are_one_line(kind, changes, message):
    table = CONTROLLER if kind is ControllerSearch else TRAINING
    with pytest.raises(ConfigurationError) as caught:
        kind.parse({**table, **changes}, "file.toml")
    assert re.search(message, str(caught.value).splitlines()[0]), str(caught.value)


def test_all_controllers_say_their_parameters():
    for task, entries in CONTROLLERS.items():
        for name, entry in entries.items():
            changed = entry.with_parameters({key: value + 1 for key, value in entry.parameters.items()})
            assert changed.parameters == {key: value + 1 for key, value in entry.parameters.items()}, (task, name)
    assert CONTROLLERS["TipPose"]["predictive"].with_parameters({"horizon": 9}).looks_ahead == 10


def test_controllers_are_tuned_from_the_command_line(tmp_path, monkeypatch, capsys):
    import tomli_w

    monkeypatch.setattr(summaries, "WORST", 10.0)  # it is far at the beginning
    file = tmp_path / "search.toml"
    file.write_text(tomli_w.dumps(CONTROLLER))
    main(["tune", str(file), "--trials", "3", "--out", str(tmp_path / "out"), "--set", "pruner=none"])
    printed = capsys.readouterr().out
    assert "3 trials: 3 complete, 0 pruned" in printed and "on other episodes: defaults " in printed
    costs = [float(row["cost"]) for row in csv.DictReader(open(tmp_path / "out" / "trials.csv"))]
    assert len({*costs}) == 3 and 0.0 < min(costs) < 10.0
    best = PolicyName.parse(str(tmp_path / "out" / "best.toml"), "TipPose")
    assert best.parameters.keys() == CONTROLLER["search"].keys() and best.estimator == "kalman"
    with pytest.raises(SystemExit):
        main(["tune", str(file), "--out", str(tmp_path / "out"), "--set", "seed=1"])
    assert "another search called search, seed was 0 and is 1" in capsys.readouterr().err


def test_trainings_are_tuned(tmp_path):
    work = Work(TrainingSearch.parse(TRAINING, "file.toml"), str(tmp_path / "study.log"), "ppo", tmp_path)
    best = tune(work._replace(search=work.search.model_copy(update={"trials": 2})), workers=1)
    assert compare(work, best, workers=1).best > 0.0
    training = read_training(tmp_path / "best.toml")
    assert training.steps == 128 and training.learning_rate == pytest.approx(best.params["learning_rate"])
    assert not (tmp_path / "trial_0" / "last").exists() and (tmp_path / "trial_0" / "best" / "weights.pt").exists()


def test_costs_of_learning_curves_are_of_errors_and_divergence():
    assert row_cost({"steps": 1, "diverged": 0, "position_error_rms": 0.3}, 4, 3.0) == 0.3
    assert row_cost({"diverged": 1, "position_error_rms": 0.2}, 4, 3.0) == pytest.approx(0.15 + 0.25 * 3.0)
    assert row_cost({"diverged": 4, "position_error_rms": np.nan}, 4, 3.0) == 3.0


@pytest.mark.parametrize("name", config_names("tune_"))
def test_searches_that_ship_are_right(name):
    search = read_search(find_config(name, "tune_"))
    first = {key: parameter.name_of(search.defaults[key]) for key, parameter in search.search.items()}
    assert None not in first.values(), "the first trial has the defaults"
