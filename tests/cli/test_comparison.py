"""Several policies, and several seeds of one, on the same episodes, and their tables."""

import csv
import json
import math
import re
import shutil
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import comparison, entrants, provenance, settings, summarise, tables
from soft_tendon_env.evaluation.metrics import ActionTime, EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.summaries import Summary, Tails, over_seeds
from soft_tendon_env.policies.agent import save_agent

CONFIGS = Path(__file__).parent.parent.parent / "configs"
METRICS = {"effort": 5.0, "tension_rate": 100.0, "chatter": 0.1}
SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.fixture(scope="session")
def ppo(tmp_path_factory):
    """The file of an agent that has learned nothing, without options beside it."""
    from stable_baselines3 import PPO

    file = tmp_path_factory.mktemp("ppo") / "model.zip"
    PPO("MlpPolicy", gym.make(IDS["TipPose"], **SMALL), n_steps=8, batch_size=4, seed=0, device="cpu").save(file)
    return file


@pytest.fixture
def runs(tmp_path, ppo):
    """A folder of two runs, as `soft-tendon sweep` leaves it: the agents have learned nothing, each in another way."""
    from stable_baselines3 import PPO

    for seed in (2, 10):
        run = tmp_path / "ppo_tip_pose" / f"seed_{seed}"
        (run / "best").mkdir(parents=True)
        (run / "config.json").write_text(json.dumps({"task": "TipPose", "algorithm": "PPO", "seed": seed, "options": SMALL}))
        shutil.copy(run / "config.json", run / "best" / "config.json")
        agent = PPO.load(ppo, device="cpu")
        agent.policy.action_net.bias.data[:] = 0.3 if seed == 2 else -0.3
        save_agent(run / "best", agent.policy, None)
    return tmp_path / "ppo_tip_pose"


def test_shipped_configs_are_valid():
    for path in CONFIGS.glob("compare*.toml"):
        table = tomllib.loads(path.read_text())
        read = settings.Comparison.parse(table, path.name)
        assert table and read.model_dump(mode="json").items() >= table.items(), "as it stands there"


def test_options_go_before_the_config_file(tmp_path, capsys, command):
    """And model errors that are given together are drawn together."""
    config, both = tmp_path / "own.toml", "tension-10%,latency-20ms"
    config.write_text('errors = ["noise"]\nepisodes = 2\nseconds = 0.2\nskip = 0.1\n[options]\nscene = "three_tendon"\nfidelity = "fast"\n')
    given = ("--task", "Shape", "--policies", "feedforward", "tracking", "--errors", "nominal", both, "--seeds", "7", "2000000")
    command("compare", "--config", config, *given, "--set", "control_period=0.04", "randomize.payload=[0, 0.1]", "--out", tmp_path)
    said = capsys.readouterr()
    assert "note: every arm, the nominal one too, has randomize = {'payload': [0, 0.1]}" in said.err
    results = json.loads((tmp_path / "Shape.json").read_text())["results"]
    assert [(own["policy"], own["model_error"]) for own in results[:2]] == [("feedforward", "nominal"), ("feedforward", both)]
    assert [[episode["seed"] for episode in own["episodes"]] for own in results] == [[7, 2_000_000]] * 4
    assert {episode["steps"] for own in results for episode in own["episodes"]} == {5}
    assert results[1]["summary"]["effort"] < results[0]["summary"]["effort"]
    record = json.loads((tmp_path / "configuration.json").read_text())
    assert record["model_errors"] == {"nominal": {}, both: {"tension_gain": 0.9, "latency": 0.02}}
    assert record["environments"][0]["options"]["fidelity"] == "fast", "of the file"


def test_a_folder_of_runs_is_one_policy(tmp_path, runs, capsys, command):
    given = ("--errors", "nominal", "--episodes", "2", "--seconds", "0.2", "--skip", "0.1", "--out", tmp_path / "out")
    command("compare", "--task", "TipPose", "--policies", "feedforward", runs, *given)
    controller, together = json.loads((tmp_path / "out" / "TipPose.json").read_text())["results"]
    assert [seed["seed"] for seed in together["seeds"]] == [2, 10] and together["policy"] == str(runs), "in the order of numbers"
    each = [seed["summary"]["errors"]["position_error"]["rms"] for seed in together["seeds"]]
    assert each[0] != each[1] and together["summary"]["errors"]["position_error"]["rms"] == pytest.approx(sum(each) / 2)
    assert together["summary"]["intervals"]["position_error_rms"] == sorted(each), "of two seeds: from one to the other"
    assert f"{runs} (2 seeds) " in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out" / "TipPose_episodes.csv").read_text().splitlines()))
    assert [(row["policy"], row["training_seed"]) for row in rows[::2]] == [("feedforward", ""), (str(runs), "2"), (str(runs), "10")]
    assert float(rows[0]["position_error_rms"]) == pytest.approx(controller["episodes"][0]["errors"]["position_error"]["rms"], rel=1e-5)


def rewrite(run, **changes):
    path = run / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda runs: shutil.rmtree(runs), "has no folders seed_0, seed_1, ..."),
        (lambda runs: rewrite(runs / "seed_10", task="Shape"), "seed_10 was trained on Shape, not on TipPose"),
        (lambda runs: rewrite(runs / "seed_10", algorithm="SAC"), "seed_10 has algorithm = 'SAC', the first seed has 'PPO'"),
        (lambda runs: shutil.rmtree(runs / "seed_10" / "best"), "seed_10 has no agent in best"),
        (lambda runs: (runs / "seed_2" / "config.json").unlink(), "seed_2 is no run: it has no config.json"),
    ],
    ids=["missing", "task", "algorithm", "unfinished", "no run"],
)
def test_folders_that_are_no_sweep(runs, spoil, said):
    spoil(runs)
    with pytest.raises((ValueError, OSError), match=re.escape(said)):
        comparison.shared_arms(settings.EpisodeSettings(), "TipPose", entrants.every_file(entrants.agents_of("TipPose", [str(runs)])))


def test_what_several_seeds_have_together():
    def seed_scores(rms, settled, diverged=None):
        errors = {"position_error": ErrorScore(rms, 2.0 * rms)}
        return [EpisodeScore(s, 10, errors, settled, METRICS, 1, 7.0, None, diverged, ActionTime(0.001, 0.002), 0.1) for s in (0, 1)]

    scores = [seed_scores(0.003, 1.0), seed_scores(0.001, 3.0), seed_scores(0.002, None), seed_scores(math.nan, None, "speed")]
    found = over_seeds([summarise(of_seed) for of_seed in scores], scores)
    assert found.errors["position_error"] == pytest.approx((0.0025, 0.005, math.nan), nan_ok=True), (
        "of four: without the best and the one without a number"
    )
    assert found.intervals["position_error_rms"].low < 0.0025 and math.isnan(found.intervals["position_error_rms"].high)
    assert (found.seeds, found.episodes, found.settled, found.settling_time, found.diverged) == (4, 8, 4, 2.0, 2)
    assert (found.bound_violations, found.mean_return, found.reached) == (8, 7.0, None)
    row = tables.error_table({("a", "nominal"): found}).splitlines()[-5]
    assert "| a (4 seeds) " in row and "| 2.50 (1.00 to -) ! / 4/8, mean 2.00, p90 3.00, 50 % bad " in row
    head, _, line, *_ = tables.summary_table("policy", {"a": found}).splitlines()
    assert [cell.strip() for cell in head.split("|")[2:6]] == ["position [mm] RMS", "mean", "p90", "bad"]
    assert [cell.strip() for cell in line.split("|")[3:6]] == ["2.00", "3.00", "50 %"]
    assert tables.csv_record(found)["position_error_p90"] == pytest.approx(0.003) and tables.csv_record(found)["bad"] == 0.5
    assert tables.SEEDS_LEGEND in tables.summary_table("policy", {"a": found})


def summary(**changes):
    values = {
        "episodes": 20,
        "diverged": 0,
        "errors": {"position_error": ErrorScore(0.0123, 0.02), "angle_error": ErrorScore(math.radians(3.0), 0.1)},
        "tails": {"position_error": Tails(0.02, 0.07), "angle_error": Tails(0.1, 0.1)},
        "worst": {"position_error": 0.1, "angle_error": 0.1},
        "bad": 0.1,
        "settled": 0,
        "settling_time": None,
        "metrics": {"effort": 5.0, "tension_rate": 1234.0, "chatter": 0.25},
        "bound_violations": 0,
        "mean_return": 400.0,
        "reached": None,
        "action_time": ActionTime(0.002, 0.004),
    }
    return Summary(**{**values, **changes})


def test_tables_flag_what_diverged():
    well, badly = {("a", "nominal"): summary()}, {("a", "nominal"): summary(diverged=1)}
    assert "12.3 / 3.00 |" in tables.error_table(well) and "!" not in tables.error_table(well)
    assert "12.3 ! / 3.00 !" in tables.error_table(badly) and tables.LEGEND in tables.error_table(badly)
    full = tables.summary_table("policy", {"a": summary(diverged=1)}, every=True)
    assert "400.0 ! | 1/20" in full, "beside the return"
    usual = tables.summary_table("policy", {"a": summary()}).splitlines()[0]
    headers = [name.strip() for name in usual.split("|")[1:-1]]
    assert headers == ["policy", "position [mm] RMS", "angle [deg] RMS", "settled", "chatter [N]", "time [ms]"]
    assert tables.LEGEND in full


def test_every_number_is_shown_for_the_arm_of_the_model():
    shown = comparison.comparison_tables
    noise, nominal = (("a", "noise"), summary()), (("a", "nominal"), summary())
    assert "policy (nominal)" in shown(dict([noise, nominal]), {"a": "none"})
    assert "policy (noise)" in shown(dict([noise]), {"a": "none"})


@pytest.mark.cases(
    "value, text", [(None, "-"), (math.nan, "-"), (12.34, "12.3"), (20.0, "20.0"), (999.7, "1000"), (123.4, "123"), (12345.6, "12346")]
)
def test_numbers_have_three_digits(value, text):
    assert tables.number(value) == text


def test_what_is_not_finite_becomes_null(tmp_path):
    provenance.write_json(tmp_path / "a.json", {"a": [math.inf, 1.0], "b": {"c": (math.nan,)}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [None, 1.0], "b": {"c": [None]}}
