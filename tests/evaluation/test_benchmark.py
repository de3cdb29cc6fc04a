"""`soft-tendon arena`: conditions, who may play in them, results that are kept, tables."""

import csv
import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env.cli.arena import Arena
from soft_tendon_env.cli.main import main
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.benchmark import Benchmark, benchmark_tables, misfit
from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import trained_alike
from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.summaries import Standing
from soft_tendon_env.policies import agent
from soft_tendon_env.policies.agent import find_agent
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.regimes import REGIMES

ROOT = Path(__file__).parents[2]
SHORT = {"scene": "three_tendon", "episodes": 2, "seconds": 0.4, "skip": 0.1, "workers": 1}
STILL = "arena_policies:Still"


class Still:
    """Pulls at nothing."""

    options = {"observation": ["tip_position", "target_error"], "action": "increment"}

    def __init__(self, env):
        self.tendons = env.action_space.shape[-1]

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros((*observation.shape[:-1], self.tendons), dtype=np.float32), state


@pytest.fixture(autouse=True)
def own_policies(monkeypatch):
    """A module of a user's, by the name that its policies have."""
    module = type(sys)("arena_policies")
    module.Still = Still
    module.__file__ = __file__
    monkeypatch.setitem(sys.modules, "arena_policies", module)


def benchmark(*policies, **more):
    return Benchmark(
        **{"entrants": tuple({"policy": policy} for policy in policies), **SHORT, **more}
    )


def test_everybody_plays_all_settings_on_the_same_episodes():
    found = benchmark(STILL, "filtered:tracking", regimes=("tip",)).cells()[0]
    assert {(label.regime, label.setting) for label in found if label.policy == STILL} == {
        ("tip", setting) for setting in SETTINGS
    }
    assert len({cell.key("code") for cell in found.values()}) == len(found)
    assert {cell.seeds for cell in found.values()} == {tuple(SEEDS["arena"][:2])}
    assert {cell.options["target"] for cell in found.values()} == {"random"}
    for label, cell in found.items():
        assert cell.options["difficulty"] == (
            label.setting if label.setting in ("easy", "hard") else "medium"
        )


@pytest.mark.parametrize("limit", [{}, {"rate_limit": 2.0}])
def test_all_entrants_have_the_same_actuators(limit):
    """Whatever an entrant observes and asks for, in every setting; the output says which."""
    played = benchmark(STILL, "filtered:tracking", "agent", scene="paper", **limit)
    cells, _ = played.cells()
    assert {label.policy for label in cells} == {STILL, "filtered:tracking", "agent"}
    rates = {cell.options["rate_limit"] for cell in cells.values()}
    assert rates == {limit.get("rate_limit")}
    said = "at most 2 N/s" if limit else "no rate limit"
    assert said in played.actuators


def test_agents_of_one_training_share_its_episodes(tmp_path):
    """Beside the files of an agent, or of a folder of runs."""
    shipped = find_agent("dagger", "Reach")
    for seed in range(3):
        if seed:
            folder = tmp_path / f"seed_{seed}"
        else:
            folder = tmp_path
        shutil.copytree(shipped, folder, dirs_exist_ok=True)
        (folder / "config.json").write_text(
            json.dumps({**json.loads((shipped / "config.json").read_text()), "seed": seed})
        )
    found = Benchmark(
        **{
            **SHORT,
            "scene": "paper",
            "task": "Reach",
            "entrants": ({"policy": str(tmp_path)},),
            "episodes": 7,
        }
    ).cells()[0]
    seeds = {label.seed: cell.seeds for label, cell in found.items()}
    assert seeds == {
        seed: tuple(SEEDS["arena"][first : first + 3]) for seed, first in enumerate((0, 3, 4))
    }
    config = json.loads((tmp_path / "seed_2" / "config.json").read_text())
    for changed, text in (
        ({"steps": 1}, "seed_2 has steps = 1, not"),
        ({"task": "Shape"}, "seed_2 has task"),
    ):
        (tmp_path / "seed_2" / "config.json").write_text(json.dumps({**config, **changed}))
        with pytest.raises(ValueError, match=text):
            trained_alike(PolicyName.parse(str(tmp_path), "Reach"))
    (tmp_path / "seed_2").rename(tmp_path / "seed_0")
    with pytest.raises(ValueError, match="seed_0 has the seed of the agent beside it"):
        trained_alike(PolicyName.parse(str(tmp_path), "Reach"))


def test_a_wheel_says_where_other_seeds_are(tmp_path, monkeypatch):
    in_clone, notes = benchmark("ppo", scene="paper", regimes=("state",)).cells()
    assert len({label.seed for label in in_clone}) == 5
    assert not notes
    shipped = agent.trained_folder()
    shutil.copytree(shipped, tmp_path / "trained", ignore=shutil.ignore_patterns("seed_*"))
    monkeypatch.setattr(agent, "trained_folder", lambda: tmp_path / "trained")
    entrants = ("ppo", "filtered:apg")
    in_wheel, notes = benchmark(*entrants, scene="paper", regimes=("state",)).cells()
    assert {label.seed for label in in_wheel} == {None}
    (note,) = notes
    assert note.startswith("ppo, filtered:apg: other seeds of the training are not in a wheel")
    assert "agents/trained of the repository: clone it" in note
    shutil.rmtree(tmp_path / "trained" / "dagger" / "TipPose")
    for name in ("apg_water", "apg_obstacles"):
        shutil.rmtree(tmp_path / "trained" / name)
    for name in ("dagger", "apg_water"):
        with pytest.raises(FileNotFoundError, match=f"'{name}' for TipPose is not in a wheel, but"):
            agent.find_agent(name, "TipPose")


@pytest.mark.parametrize(
    ("observed", "regime", "reason"),
    [
        *(
            ({"observation": ["tip_position", "coordinates"]}, regime, "it observes coordinates")
            for regime in REGIMES
        ),
        ({"observation": ["strain"], "sensors": 4}, "sensors", "it has 4 strain sensors"),
        ({"observation": ["strain"], "sensors": 4}, "state", ""),
    ],
)
def test_policies_observe_what_a_regime_has(observed, regime, reason):
    """Coordinates are in none: they mean other shapes on a finer arm."""
    assert (
        misfit(PolicyName.parse(STILL, "TipPose"), {"scene": "three_tendon", **observed}, regime)
        == reason
    )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"entrants": ({"policy": "predictive"},)},
            r"predictive is left out: no regime has what it needs \(state: it observes coordinates",
        ),
        (
            {"entrants": ({"policy": "nobody"},)},
            "nobody can play: nobody is left out: policy is 'nobody', no policy",
        ),
        (
            {"entrants": ({"policy": "arena_policies:Moving"},)},
            "should be module:name of what makes a policy",
        ),
        (
            {"settings": ("nominal", "space")},
            r"settings\[1\] is 'space': it should be a setting: .*nominal",
        ),
        ({"entrants": ({"policy": STILL}, {"policy": STILL})}, "several times"),
        ({"regimes": ("all",)}, r"regimes\[0\] is 'all': it should be an information"),
        ({"seconds": 0.2, "skip": 0.3}, "at least one control period"),
    ],
)
def test_mistakes_name_what_is_allowed(given, text):
    with pytest.raises(ValueError, match=text):
        Benchmark(**{**SHORT, "entrants": ({"policy": STILL},), **given}).cells()


@pytest.mark.parametrize(("setting", "effect"), [("water", "fluid"), ("nominal", None)])
def test_controllers_believe_in_the_effects_of_a_setting_only_where_they_are_told(setting, effect):
    """At the fidelity that they name; and are another policy only where there are such effects."""
    entrants = tuple(
        {"policy": "filtered:tracking@fast", "name": name, "told": name == "told"}
        for name in ("told", "untold")
    )
    told, untold = (
        Benchmark(**{**SHORT, "entrants": entrants, "settings": (setting,), "regimes": ("tip",)})
        .cells()[0]
        .values()
    )
    if effect is None:
        effects = []
    else:
        effects = [effect]
    for cell, believes in ((told, effects), (untold, [])):
        policy, envs = cell.open()
        believed = policy.observer.estimator.model
        there = episodes_of(envs).model
        assert [*believed.scene.effects.chosen()] == believes
        assert [*there.scene.effects.chosen()] == effects
        assert believed.coordinate_count < there.coordinate_count
    assert (told.key("code") == untold.key("code")) == (effect is None)


def standing(error):
    """Standing of two episodes with an error [m] on a rod of 1 m."""
    scores = []
    for seed in range(2):
        episode = EpisodeScore(
            seed=seed,
            steps=10,
            errors={"position_error": ErrorScore(error, error)},
            settled=False,
            metrics={},
            total_reward=-error,
            reached=None,
            diverged=None,
            action_time=0.001,
            length=1.0,
        )
        scores.append(episode)
    return Standing([scores])


@pytest.mark.parametrize(("other", "kind"), [("ppo", "learned policy"), (STILL, "other policy")])
def test_gaps_are_of_who_is_no_controller_to_the_controllers(other, kind):
    played = benchmark(other, "filtered:tracking", settings=("nominal",))
    standings = {
        (other, "nominal"): standing(0.001),
        ("filtered:tracking", "nominal"): standing(0.003),
    }
    text = benchmark_tables(played, {"state": standings})
    assert f"The best {kind} beside the best controller:" in text
    assert "- By position: ahead in all." in text
    assert "- By return: ahead in all." in text
    assert "-2.00 (-2.00 to -2.00)" in text
    assert f"best {kind} minus best controller" in text


@pytest.mark.slow
def test_the_command_plays_resumes_and_writes(tmp_path, capsys):
    config = tmp_path / "small.toml"
    out = tmp_path / "out"
    table = "".join(
        f"{key} = {json.dumps(value)}\n"
        for key, value in {**SHORT, "settings": ["nominal", "latency"]}.items()
    )
    entrants = "".join(
        f'[[entrants]]\npolicy = "{policy}"\n' for policy in ("filtered:tracking@fast", STILL)
    )
    config.write_text(f'{table}regimes = ["tip"]\n{entrants}')
    command = ["arena", "--config", str(config), "--out", str(out), "--rate-limit", "20"]
    main([*command, "--settings", "nominal"])
    assert "2 cells, 2 of them to be played" in capsys.readouterr().out
    main(command)
    said = capsys.readouterr().out
    assert "4 cells, 2 of them to be played" in said
    for heading, number in (
        ("position [mm] RMS", r"[0-9.]+ \([0-9.]+\)"),
        ("angle [deg] RMS", r"[0-9.]+ \([0-9.]+\)"),
        ("return", r"[0-9.]+ \([0-9.]+\)"),
        ("bad episodes [%]", "[0-9]+"),
    ):
        assert f"| {heading} " in said
        table = said[said.index(f"| {heading} ") :]
        assert table.split("\n")[0].split("|")[2].strip() == "filtered:tracking@fast"
        assert re.search(rf"\| latency +\| {number} +\| {number} +\|", table)
    assert "### Noisy sensors without strains" in said
    # Still is a user's own: nobody knows whether it has learned.
    assert "| best other policy minus best controller | position [mm]" in said
    assert re.search(r"\| latency +\| -?[0-9.]+ \(-?[0-9.]+ to -?[0-9.]+\)", said)
    assert "best learned" not in said
    assert (
        len(
            re.findall(
                r"^- By (position|return): (ahead|behind|not separated) in"
                r" (nominal|latency|all)",
                said,
                re.MULTILINE,
            )
        )
        == 2
    )
    main(command)
    assert "4 cells, 0 of them to be played" in capsys.readouterr().out
    assert (out / "arena.png").stat().st_size > 10_000
    page = (out / "arena.md").read_text()
    assert page.index("- `latency`: ") < page.index("### ")
    assert "(arena.png)" in page
    assert "change by at most 20 N/s" in page
    assert "change by at most 20 N/s" in said
    rows = list(csv.DictReader((out / "arena.csv").open()))
    assert {row["policy"] for row in rows} == {"filtered:tracking@fast", STILL}
    assert all(float(row["position_error_rms"]) > 0 for row in rows)


@pytest.mark.slow
def test_the_published_comparison_can_be_played(monkeypatch):
    """By all of its policies, with the files that ship."""
    monkeypatch.chdir(ROOT)
    published = Arena.read_file("published")
    cells, notes = published.cells()
    assert notes == []
    assert {label.policy for label in cells} == {entrant.name for entrant in published.entrants}
    assert published.episodes == 100
    assert published.rate_limit == 150.0
    assert {cell.seconds for cell in cells.values()} == {4.0}
