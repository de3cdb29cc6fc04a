"""Who is compared: runs of one training, and what policies know of the arm while they play."""

import json
import re

import pytest

from soft_tendon_env.evaluation.comparison import make_cell, numbers_table, shared_arms
from soft_tendon_env.evaluation.entrants import agents_of, model_in_the_loop, seed_files
from soft_tendon_env.evaluation.settings import Settings
from soft_tendon_env.evaluation.summaries import ErrorScore, Summary
from soft_tendon_env.policies.names import PolicyName


@pytest.fixture
def runs(tmp_path):
    """A folder of two runs, as `soft-tendon sweep` leaves it, less the networks."""
    for seed in (10, 2):
        best = tmp_path / f"seed_{seed}" / "best"
        best.mkdir(parents=True)
        config = {"task": "TipPose", "algorithm": "PPO", "seed": seed}
        (best.parent / "config.json").write_text(json.dumps(config))
    return tmp_path


def test_seeds_of_a_training_are_the_best_agents_of_its_runs(runs):
    by_seed = seed_files(runs, "TipPose")
    assert list(by_seed) == [2, 10]
    assert by_seed[10] == str(runs / "seed_10" / "best")
    assert seed_files(runs / "seed_10", "TipPose") == {}, "a run is no folder of runs"
    assert agents_of("TipPose", [str(runs), "ppo"])["ppo"] == {None: "ppo"}


def test_seeds_of_a_training_stand_behind_the_same_filter(runs):
    name = f"filtered:{runs}@fast"
    by_seed = agents_of("TipPose", [name])[name]
    assert by_seed[10] == f"filtered:{runs / 'seed_10' / 'best'}@fast"
    assert list(by_seed) == [2, 10]


def test_a_run_without_its_best_agent_is_refused(runs):
    (runs / "seed_2" / "best").rmdir()
    message = re.escape("seed_2 has no agent in best")
    with pytest.raises(FileNotFoundError, match=message):
        seed_files(runs, "TipPose")


@pytest.mark.parametrize(
    ("policy", "told", "words"),
    [
        ("ppo", False, "none"),
        ("tracking", False, "controller"),
        ("filtered:tracking", False, "controller, kalman estimator"),
        ("filtered:tracking", True, "controller, kalman estimator, told of the effects"),
    ],
)
def test_controllers_use_a_model_and_agents_none(policy, told, words):
    name = PolicyName.parse(policy, "TipPose")
    assert model_in_the_loop(name, told) == words


def test_everybody_acts_on_the_arm_of_the_agents(capsys):
    files = {"ppo": {None: "ppo"}, "tracking": {None: "tracking"}}
    arms = shared_arms(Settings(), "TipPose", files)
    assert arms.keys() == {"ppo", "tracking"}
    assert {arm["fidelity"] for arm in arms.values()} == {"fast"}
    assert "on the arm of the agents, fidelity = 'fast'" in capsys.readouterr().err
    # controllers alone have the usual arm
    (alone,) = shared_arms(Settings(), "TipPose", {"tracking": {None: "tracking"}}).values()
    assert "fidelity" not in alone
    assert not capsys.readouterr().err


def test_what_the_options_say_of_the_arm_goes_before_the_agents():
    settings = Settings(options={"fidelity": "fine"})
    arms = shared_arms(settings, "TipPose", {"tracking": {None: "tracking"}, "ppo": {None: "ppo"}})
    assert {arm["fidelity"] for arm in arms.values()} == {"fine"}


def test_an_agent_plays_alone_and_controllers_in_rows():
    """A network rounds otherwise for many observations than for one."""
    seeds = (7, 8, 9)
    settings = Settings(seconds=1.0, skip=0.5)
    in_rows = {}
    for policy in ("tracking", "ppo"):
        cell = make_cell(settings, seeds, "TipPose", policy, {}, "payload-20g")
        in_rows[policy] = cell.rows
        assert tuple(cell.seeds) == seeds
        assert cell.options["randomize"] == {"payload": 0.02}
    assert in_rows == {"tracking": True, "ppo": False}


def test_the_time_of_an_action_is_taken_alone_on_the_arm_of_the_model():
    drawn = {"randomize": {"latency": 0.02}}
    cell = make_cell(Settings(), (7, 8, 9), "TipPose", "tracking", drawn)
    assert tuple(cell.seeds) == (7,)
    assert cell.alone
    assert not cell.rows
    assert cell.options["randomize"] == drawn["randomize"]


def summary_of(error):
    """Summary of an error [m] of position."""
    return Summary(
        episodes=2,
        diverged=0,
        errors={"position_error": ErrorScore(error, error)},
        settled=0,
        metrics={},
        mean_return=0.0,
        reached=None,
        action_time=0.001,
    )


def test_one_policy_has_a_row_for_every_model_error_and_several_have_one_each():
    summaries = {
        ("tracking", "damping-halved"): summary_of(0.003),
        ("tracking", "nominal"): summary_of(0.001),
        ("ppo", "damping-halved"): summary_of(0.004),
        ("ppo", "nominal"): summary_of(0.002),
    }
    of_tracking = {key: value for key, value in summaries.items() if key[0] == "tracking"}
    files = {"tracking": {None: "tracking"}}
    _, _, *rows = numbers_table("TipPose", files, of_tracking).split("\n")
    words = [row.replace("|", " ").split() for row in rows]
    assert [row[:2] for row in words] == [["damping-halved", "3.00"], ["nominal", "1.00"]]
    assert [row[-1] for row in words] == ["controller", "controller"]

    files["ppo"] = {0: "ppo", 1: "ppo"}
    heading, _, *rows = numbers_table("TipPose", files, summaries).split("\n")
    assert "policy (nominal)" in heading
    words = [row.replace("|", " ").split() for row in rows]
    assert [row[:2] for row in words] == [["tracking", "1.00"], ["ppo", "2.00"]]
    assert [row[-1] for row in words] == ["controller", "none"]
