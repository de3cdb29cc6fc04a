"""`soft-tendon arena`: conditions, who may play in them, results that are kept, tables, recordings."""

import csv
import json
import re
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.arena import page
from soft_tendon_env.arena.pictures import draw_arena
from soft_tendon_env.arena.protocol import Protocol
from soft_tendon_env.arena.standings import kinds_of, standings_of
from soft_tendon_env.cli import arena
from soft_tendon_env.cli.main import main
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.comparison import alone
from soft_tendon_env.evaluation.conditions import BELIEF, DIFFICULTIES, SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import interface_options, misfit, model_in_the_loop
from soft_tendon_env.evaluation.experiment import Experiment, code_version, measure
from soft_tendon_env.policies.agent import save_agent
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.regimes import NOISE, REGIMES
from soft_tendon_env.scene.file import load_scene

ROOT = Path(__file__).parents[2]
SHORT = {"scene": "three_tendon", "episodes": 2, "seconds": 0.4, "skip": 0.1, "workers": 1}
STILL = "arena_policies:Still"


class Still:
    """Pulls at nothing."""

    options = {"observation": ["tip_position", "target_error"], "action": "increment"}

    def __init__(self, env):
        self.tendons = env.action_space.shape[-1]

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros((len(observation), self.tendons) if observation.ndim == 2 else self.tendons, dtype=np.float32), state


@pytest.fixture(autouse=True)
def own_policies(monkeypatch):
    """A module of a user's, by the name that its policies have."""
    module = type(sys)("arena_policies")
    module.Still, module.__file__ = Still, __file__
    monkeypatch.setitem(sys.modules, "arena_policies", module)


def protocol(*policies, **more):
    return Protocol(**{"entrants": tuple({"policy": policy} for policy in policies), **SHORT, **more})


def seeds_of_training(folder, count):
    """Folder of agents of several seeds, which observe what every regime has; their weights are not read."""
    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_position", "target_error"]}
    config = json.dumps({"task": "TipPose", "algorithm": "PPO", "options": options})
    for seed in range(count):
        best = folder / "seeds" / f"seed_{seed}" / "best"
        best.mkdir(parents=True)
        for path in (best.parent / "config.json", best / "config.json"):
            path.write_text(config)
        (best / "weights.pt").touch()
    return str(folder / "seeds")


def only(one):
    """The first cell of a protocol."""
    return next(iter(one.cells().values()))


def named(policy):
    return PolicyName.parse(policy, "TipPose")


@pytest.mark.parametrize("setting", SETTINGS)
def test_every_setting_makes_an_arm_that_differs_as_it_says(setting):
    """Among other things it moves otherwise than the nominal one under the same pull, and is as fine."""

    def moved(name):
        cell = only(protocol(STILL, scene="paper", settings=(name,), difficulties=(), regimes=("state",), seconds=4.0, episodes=1))
        _, envs = cell.open()
        envs.reset(seed=[SEEDS["arena"][0]])
        episodes = episodes_of(envs)
        pull, path = np.zeros((1, 10), dtype=np.float32), []  # increments
        pull[:, 0] = 0.05
        for _ in range(150):
            envs.step(pull)
            path.append(episodes.arms.reading.tip_pose[0, :3, 3].copy())
        return np.array(path), episodes.model.coordinate_count

    (there, coordinates), (nominal, _) = moved(setting), moved("nominal")
    assert coordinates > build_model(load_scene("paper"), BELIEF).coordinate_count
    assert (np.linalg.norm(there - nominal, axis=1).max() > 1e-3) == (setting != "nominal")


def test_targets_that_jump_hold_still_between_and_differ():
    env = gym.make(IDS["TipPose"], scene="three_tendon", fidelity="fast", target={"type": "steps", "duration": 0.5, "count": 3})
    env.reset(seed=0)
    times = np.array([0.0, 0.3, 0.49, 0.5, 0.9, 1.0, 1.4, 1.5, 1.9])
    target = env.unwrapped.episodes.target_at(0, times)
    place = target.tip_pose[:, :3, 3]
    assert np.allclose(place[0], place[[1, 2, 7, 8]]) and np.allclose(place[3], place[4]) and np.allclose(place[5], place[6])
    assert np.linalg.norm(place[0] - place[3]) > 1e-3 and np.linalg.norm(place[3] - place[5]) > 1e-3
    assert not target.tip_twist.any()


def test_poses_out_of_reach_are():
    env = gym.make(IDS["TipPose"], scene="three_tendon", fidelity="fast", target={"type": "out_of_reach", "beyond": 1.5})
    for seed in range(3):
        env.reset(seed=seed)
        assert np.linalg.norm(env.unwrapped.episodes.target_pose[0, :3, 3]) == pytest.approx(0.45)


def test_everybody_plays_all_settings_at_one_difficulty_and_the_nominal_one_at_all():
    found = protocol(STILL, "filtered:tracking", regimes=("tip",)).cells()
    conditions = {label.condition for label in found if label.entrant == STILL}
    assert conditions == {("tip", setting, "medium") for setting in SETTINGS} | {("tip", "nominal", of) for of in DIFFICULTIES}
    assert len({cell.key("code") for cell in found.values()}) == len(found)
    assert {cell.seeds for cell in found.values()} == {tuple(SEEDS["arena"][:2])}


def test_noise_is_on_all_that_is_observed_where_there_is_noise():
    """Of one arm at rest: every entry that is measured changes from step to step."""
    for regime in ("sensors", "tip"):
        groups = [*REGIMES[regime].measured]
        options = {"observation": groups, "sensors": 3, "randomize": {"noise": NOISE}, "scene": "three_tendon", "fidelity": "fast"}
        env = gym.make(IDS["TipPose"], **options, disable_env_checker=True)
        seen = np.stack([env.reset(seed=0)[0], *(env.step(np.full(3, -1.0, dtype=np.float32))[0] for _ in range(5))])
        assert (np.ptp(seen, axis=0) > 0.0).all()


@pytest.mark.cases(
    "observed, regime, reason",
    [
        *(({"observation": ["tip_position", "coordinates"]}, regime, "it observes coordinates") for regime in REGIMES),
        ({"observation": ["strain"], "sensors": 4}, "sensors", "it has 4 strain sensors"),
        ({"observation": ["strain"], "sensors": 4}, "state", ""),
    ],
)
def test_policies_observe_what_a_regime_has(observed, regime, reason):
    """Coordinates are in none: they mean other shapes on a finer arm."""
    assert misfit(named(STILL), {"scene": "three_tendon", **observed}, regime) == reason


@pytest.mark.cases("policy", ["filtered:tracking", STILL])
def test_policies_play_where_what_they_need_is_observed(policy):
    assert [*dict.fromkeys(label.condition.regime for label in protocol(policy).cells())] == ["state", "sensors", "tip"]


def test_an_agent_of_another_clock_plays_in_no_regime(tmp_path):
    (tmp_path / "weights.pt").touch()
    (tmp_path / "config.json").write_text(
        json.dumps({"algorithm": "PPO", "options": {"observation": ["tip_position"], "control_period": 0.01}})
    )
    with pytest.raises(ValueError, match="can play in no regime .state: it was trained with control_period = 0.01"):
        protocol(str(tmp_path)).cells()


@pytest.mark.cases(
    "policy, needed",
    [("agent", "none"), ("predictive", "controller"), ("adaptive:predictive@fast", "controller, adaptive estimator"), (STILL, "own")],
)
def test_controllers_need_a_model_and_own_policies_may(policy, needed):
    assert model_in_the_loop(named(policy)) == needed


def test_an_own_policy_without_options_observes_all_that_a_regime_has(monkeypatch):
    monkeypatch.setattr(Still, "options", {})
    found = interface_options(named(STILL), "sensors")
    assert found == {"observation": [*REGIMES["sensors"].groups[:-1]], "sensors": 3}, "but for lengths, which are of shapes"


@pytest.mark.cases(
    "policy, text",
    [
        ("predictive", "predictive can play in no regime .*coordinates.*does not depend on the discretisation"),
        ("nobody", "policy is 'nobody', no policy"),
        ("arena_policies:Moving", "should be module:name of what makes a policy"),
    ],
)
def test_who_is_no_policy_is_refused_before_anything_is_played(policy, text):
    with pytest.raises(ValueError, match=text):
        protocol(policy).cells()


@pytest.mark.cases(
    "given, text",
    [
        ({"settings": ("nominal", "space")}, r"settings\[1\] is 'space': it should be a setting: .*nominal"),
        ({"difficulty": "harder"}, "difficulty is 'harder': it should be a difficulty: did you mean 'hard'"),
        ({"entrants": ({"policy": STILL}, {"policy": STILL})}, "several times"),
        ({"entrants": ({"policy": STILL, "regimes": ("all",)},)}, r"entrants\[0\].regimes\[0\] is 'all': it should be an information"),
        ({"entrants": ({"policy": STILL, "settings": ("space",)},)}, r"entrants\[0\].settings\[0\] is 'space': .*nominal"),
        ({"seconds": 0.2, "skip": 0.3}, "at least one control period"),
        *(({"entrants": ({"policy": own, "told": True},)}, "told is true of .*: it is for contr") for own in (STILL, "agent", "a/folder")),
    ],
)
def test_mistakes_of_a_protocol_name_what_is_allowed(given, text):
    with pytest.raises(ValueError, match=text):
        Protocol(**{**SHORT, "entrants": ({"policy": STILL},), **given}).cells()


@pytest.mark.parametrize("setting, effect", [("water", "fluid"), ("obstacles", "contact"), ("load", "gravity"), ("nominal", None)])
def test_controllers_believe_in_the_effects_of_a_setting_only_where_they_are_told(setting, effect):
    """At the fidelity that they name; and are another policy only where there are such effects."""
    entrants = tuple({"policy": "filtered:tracking@fast", "name": name, "told": name == "told"} for name in ("told", "untold"))
    one = Protocol(**{**SHORT, "entrants": entrants, "settings": (setting,), "difficulties": (), "regimes": ("tip",)})
    told, untold = one.cells().values()
    effects = [] if effect is None else [effect]
    for cell, believes in ((told, effects), (untold, [])):
        policy, envs = cell.open()
        believed, there = policy.estimator.model, episodes_of(envs).model
        assert [*believed.scene.effects.chosen()] == believes and [*there.scene.effects.chosen()] == effects
        assert believed.coordinate_count < there.coordinate_count
    assert (told.key("code") == untold.key("code")) == (effect is None)


def test_a_plain_function_is_a_policy():
    """It plays as what has `predict` does, and acts on all rows at once."""
    sizes = []

    def still(env):
        def act(observation):
            sizes.append(observation.shape)
            return np.zeros((len(observation), 3))

        return act

    still.options = Still.options
    one = only(protocol(STILL, settings=("nominal",), difficulties=(), regimes=("tip",)))
    before = measure(one)
    sys.modules["arena_policies"].Still = still
    after = measure(one)
    assert set(sizes) == {(2, 9)}
    (single,) = measure(alone(one))
    assert sizes[-1] == (1, 9) and single["errors"] == before[0]["errors"], "a single observation is a row too"
    assert [{**record, "action_time": 0} for record in after] == [{**record, "action_time": 0} for record in before]


def test_another_file_of_an_agent_is_another_policy(tmp_path):
    """The same folder with other weights is played again."""
    from stable_baselines3 import PPO

    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_position", "target_error"]}
    agent = PPO("MlpPolicy", gym.make(IDS["TipPose"], **options), n_steps=8, batch_size=4, seed=0, device="cpu")
    config = {"task": "TipPose", "algorithm": "PPO", "options": options}

    def keys(bias):
        agent.policy.action_net.bias.data[:] = bias
        (tmp_path / "config.json").write_text(json.dumps(config))
        save_agent(tmp_path, agent.policy, None)
        return [cell.key(code_version()) for cell in protocol(str(tmp_path), settings=("nominal",), difficulties=()).cells().values()]

    first = keys(0.1)
    played = [measure(cell)[0] for cell in protocol(str(tmp_path), settings=("nominal", "load"), difficulties=()).cells().values()]
    errors = {record["errors"]["position_error"]["rms"] for record in played}
    assert len(errors) == 4, "noise does not reach an agent that acts on nothing but its bias"
    assert len(first) == 3 and keys(0.1) == first and not set(keys(0.2)) & set(first)
    assert kinds_of(protocol(str(tmp_path))) == {str(tmp_path): "learned"}


def test_the_command_plays_resumes_and_writes(tmp_path, capsys):
    config, docs = tmp_path / "small.toml", tmp_path / "page.md"
    table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in {**SHORT, "settings": ["nominal"], "difficulties": ["easy"]}.items())
    config.write_text(f'{table}regimes = ["tip"]\n[[entrants]]\npolicy = "filtered:tracking@fast"\n[[entrants]]\npolicy = "{STILL}"\n')
    docs.write_text("before\n<!-- arena TipPose -->\n<!-- /arena TipPose -->\nafter\n")
    command = ["arena", "--config", str(config), "--out", str(tmp_path / "out")]
    main([*command, "--only-estimate"])
    said = capsys.readouterr().out
    assert "4 cells, 4 of them to be played" in said and re.search("estimated time: [1-9][0-9]* (s|min), 1 side by side", said)
    main([*command, "--settings", "nominal", "--difficulties", "medium"])
    assert "2 cells, 2 of them to be played" in capsys.readouterr().out
    main([*command, "--write-docs", str(docs)])
    first = capsys.readouterr().out
    assert "4 cells, 2 of them to be played" in first and "filtered:tracking@fast (model-based)" in first
    main(command)
    said = capsys.readouterr().out
    assert "4 cells, 0 of them to be played" in said and "estimated time: 0 s" in said
    assert docs.with_suffix(".png").stat().st_size > 10_000 and "(page.png)" in docs.read_text()
    main([*command, "--settings", "latency", "--only-tables"])
    assert "nominal" in docs.read_text() and docs.read_text().startswith("before") and docs.read_text().endswith("after\n")
    rows = list(csv.DictReader((tmp_path / "out" / "arena.csv").open()))
    assert {row["entrant"] for row in rows} == {"filtered:tracking@fast", STILL}
    assert all(float(row["position_error_rms"]) > 0 for row in rows)
    assert (tmp_path / "out" / "arena.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "out" / "arena.json").read_text())["protocol"]["episodes"] == 2


def test_seeds_of_training_share_the_episodes(tmp_path):
    """Each plays its part in turn, and at least so many that all are played; or all."""
    folders = seeds_of_training(tmp_path, 3)

    def played(**more):
        one = protocol(folders, settings=("nominal",), difficulties=(), regimes=("tip",), episodes=6, **more)
        return [[seed - SEEDS["arena"][0] for seed in cell.seeds] for cell in one.cells().values()]

    assert played() == [[*range(6)]] * 3
    assert played(episodes_per_seed=1) == played(episodes_per_seed=2) == [[0, 1], [2, 3], [4, 5]]
    assert played(episodes_per_seed=4) == [[0, 1, 2, 3], [4, 5, 0, 1], [2, 3, 4, 5]]


def test_optional_entrants_are_left_out_where_they_cannot_play(tmp_path):
    missing, seeds = str(tmp_path / "none"), seeds_of_training(tmp_path, 2)
    entrants = [
        {"policy": STILL},
        {"policy": STILL, "seeds": missing, "name": "single"},
        {"policy": missing, "seeds": seeds, "name": "seeds"},
        {"policy": missing, "name": "gone", "optional": True},
        {"policy": "predictive", "optional": True},
    ]
    found, notes = Protocol(**SHORT, entrants=entrants).present()
    assert [entrant.label for entrant in found.entrants] == [STILL, "single", "seeds"]
    assert [entrant.plays for entrant in found.entrants] == [STILL, STILL, seeds]
    single, gone, misfits = notes
    assert single == f"single is a single training, {STILL}: there is no folder {missing} of several"
    assert gone.startswith("gone is left out: ") and missing in gone and misfits.startswith("predictive is left out: predictive can")
    with pytest.raises(FileNotFoundError, match="has no folders seed_0"):
        Protocol(**SHORT, entrants=[{"policy": missing}]).present()
    with pytest.raises(ValueError, match="nobody can play: gone is left out"):
        Protocol(**SHORT, entrants=entrants[3:]).present()


def test_who_is_for_other_regimes_is_left_out_without_a_word():
    entrants = [{"policy": STILL, "regimes": ("tip",)}, {"policy": "filtered:tracking", "regimes": ("state",)}]
    found, notes = Protocol(**{**SHORT, "regimes": ("state",)}, entrants=entrants).present()
    assert [entrant.policy for entrant in found.entrants] == ["filtered:tracking"] and not notes
    with pytest.raises(ValueError, match="nobody can play: all entrants are for other regimes or settings"):
        Protocol(**{**SHORT, "regimes": ("sensors",)}, entrants=entrants).present()
    specialist = protocol(regimes=("tip",), entrants=({"policy": STILL, "settings": ("water", "load")},)).cells()
    assert [label.condition.setting for label in specialist] == ["load", "water"]


def test_tables_and_pictures_leave_out_where_nobody_plays(tmp_path):
    entrants = [{"policy": STILL}, {"policy": "filtered:tracking@fast", "name": "specialist", "settings": ("latency",)}]
    one = Protocol(**SHORT, entrants=entrants, settings=("nominal", "latency"), difficulties=(), regimes=("tip",))
    experiment = Experiment(one.cells(), tmp_path / "cells")
    experiment.play("arena", 1)
    found = standings_of(one, experiment)
    (row,) = [line for line in page.tables(found).splitlines() if line.startswith("| specialist (model-based)")]
    nominal, latency = (cell.strip() for cell in row.split("|")[2:4])
    assert nominal == "-" and re.match(r"\**[0-9.]+ \(", latency)
    (verdict,) = [line for line in page.tables(found).splitlines() if line.startswith("| tip ")]
    assert verdict.split("|")[2].strip() == "latency" and verdict.split("|")[-2].strip() in ("ahead", "behind", "not separated")
    draw_arena(found, tmp_path / "arena.png")
    assert (tmp_path / "arena.png").stat().st_size > 10_000


def test_estimates_are_near_what_it_takes(tmp_path):
    """Of the time on a core; measured twice, as compiling would be in the first."""
    one = protocol("filtered:tracking@fast", settings=("nominal", "load"), difficulties=(), regimes=("tip",), episodes=6, seconds=1.0)
    experiment = Experiment(one.cells(), tmp_path / "cells")
    seconds = experiment.estimate(1)
    started = time.process_time()
    experiment.play("arena", 1)
    assert 0.3 < seconds / (time.process_time() - started) < 3.0
    assert experiment.estimate(1) == 0.0, "there is nothing left to be played"


def test_the_published_comparison_can_be_played(monkeypatch):
    """Also without seeds of training, where the agents that ship play alone; who is left out has no files, or observes too much."""
    monkeypatch.chdir(ROOT)
    published, notes = arena.Arena(**arena.read_file({})).present()
    kinds = kinds_of(published)
    assert {"model-based", "learned"} == {*kinds.values()}
    assert {"printed law", "MPC, filter for exact sensors", "MPC, told", "DAgger"} <= {*kinds}
    assert published.episodes == 100 and {cell.seconds for cell in published.cells().values()} == {4.0}
    assert all(re.search("is a single training|left out: .*(has no folders|does not ship|in no regime)", note) for note in notes)
