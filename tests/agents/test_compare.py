"""compare.py as a user runs it, and what it does with several policies."""

import csv
import json
import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.control import CONTROLLERS, Decision, Entry
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.scores import ActionTime, ErrorScore, Summary

AGENTS = Path(__file__).parent.parent.parent / "agents"
SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.fixture(scope="session")
def ppo(tmp_path_factory):
    """The file of an agent that has learned nothing, without options beside it."""
    from stable_baselines3 import PPO

    file = tmp_path_factory.mktemp("ppo") / "model.zip"
    PPO("MlpPolicy", gym.make(IDS["TipPose"], **SMALL), n_steps=8, batch_size=4, seed=0, device="cpu").save(file)
    return file


class Share:
    """A controller that pulls with a share of what it may, all tendons alike."""

    def __init__(self, share):
        self._share = share

    def __call__(self, model, limits, period):
        self._tension = limits[:, 0] + self._share * (limits[:, 1] - limits[:, 0])
        return self

    def act(self, now, memory=None):
        return Decision(self._tension)


@pytest.fixture
def catalogue(monkeypatch):
    """Two controllers for every task, and no other."""
    for entries in CONTROLLERS.values():
        for name in list(entries):
            monkeypatch.delitem(entries, name)
        monkeypatch.setitem(entries, "slack", Entry("does nothing", Share(0.0)))
        monkeypatch.setitem(entries, "far", Entry("looks ahead", Share(0.1), looks_ahead=2))


def main(module, monkeypatch, *arguments):
    """compare.py in this process."""
    monkeypatch.setattr(sys, "argv", ["compare.py", *map(str, arguments)])
    module("compare").main()


def write_config(folder, **changes):
    values = {"errors": ["nominal", "tension-10%"], "episodes": 2, "seconds": 0.2, "skip": 0.1, "workers": 1, **changes}
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    path = folder / "own.toml"
    path.write_text("\n".join([*lines, "[options]", *(f"{key} = {json.dumps(value)}" for key, value in SMALL.items())]))
    return path


@pytest.mark.slow  # every process loads torch
def test_an_agent_is_compared_with_itself_by_two_processes(tmp_path, ppo):
    config = write_config(tmp_path, tasks=["TipPose"], policies=[str(ppo), f"PPO:{ppo}"], workers=2)
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, AGENTS / "compare.py", "--config", config]
    printed = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True).stdout
    assert sum(line.startswith(("| PPO:", f"| {ppo}")) for line in printed.splitlines()) == 4, "two tables of two policies"
    out = tmp_path / "out" / "compare"
    with open(out / "TipPose.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["model_error"] for row in rows] == ["nominal", "tension-10%"] * 2
    assert [row["position_error_rms"] for row in rows[:2]] == [row["position_error_rms"] for row in rows[2:]], "bit for bit"
    results = json.loads((out / "TipPose.json").read_text())["results"]
    assert [len(result["episodes"]) for result in results] == [2] * 4
    assert (out / "TipPose.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "configuration.json").read_text())["settings"]["policies"] == [str(ppo), f"PPO:{ppo}"]


def test_all_controllers_of_all_tasks_by_default(tmp_path, catalogue, module, monkeypatch, capsys):
    docs = tmp_path / "docs.md"
    docs.write_text("\n".join(f"<!-- compare {task} -->\nold\n<!-- /compare {task} -->\nkept" for task in IDS))
    main(module, monkeypatch, "--config", write_config(tmp_path), "--out", tmp_path, "--write-docs", docs)
    printed, written = capsys.readouterr().out, docs.read_text()
    for task in IDS:
        assert f"## {task}" in printed
        results = json.loads((tmp_path / f"{task}.json").read_text())["results"]
        found = {(result["policy"], result["model_error"]): result["summary"] for result in results}
        assert set(found) == {(policy, error) for policy in ("slack", "far") for error in ("nominal", "tension-10%")}
        assert found["far", "tension-10%"]["effort"] == pytest.approx(0.9 * found["far", "nominal"]["effort"])
        assert found["slack", "nominal"]["errors"] == found["slack", "tension-10%"]["errors"], "nothing is nothing"
        assert (found["slack", "nominal"]["reached"] is None) == (task != "Reach")
        assert found["far", "nominal"]["action_time"] == found["far", "tension-10%"]["action_time"], "measured once"
    for line in printed.splitlines():
        assert not line.startswith("|") or line in written
    assert "old" not in written and written.count("kept") == len(IDS)


def test_arguments_go_before_the_config_file(tmp_path, catalogue, module, monkeypatch):
    config = write_config(tmp_path)
    only = ("--task", "Shape", "--policies", "far", "--errors", "nominal", "--episodes", "1", "--options", '{"control_period": 0.04}')
    main(module, monkeypatch, "--config", config, *only, "--out", tmp_path)
    (result,) = json.loads((tmp_path / "Shape.json").read_text())["results"]
    (episode,) = result["episodes"]
    assert (result["policy"], result["model_error"], episode["steps"]) == ("far", "nominal", 5)
    (environment,) = json.loads((tmp_path / "configuration.json").read_text())["environments"]
    assert environment["options"]["preview"] == pytest.approx([0.04, 0.08]), "what the controller looks at, in its periods"
    assert environment["options"]["fidelity"] == "fast", "of the file, beside what was given"


@pytest.mark.parametrize(
    "changes, arguments, said",
    [
        ({"episods": 3}, (), "own.toml: episods is an unknown key (given 3): did you mean 'episodes'?"),
        ({"tasks": ["Tip"]}, (), "tasks[0] is 'Tip'"),
        ({}, ("--policies", "slak"), "did you mean 'slack'?"),
        ({}, ("--scene", "no_scene"), "no_scene"),
        ({}, ("--write-docs", "{folder}/docs.md"), "should have the lines <!-- compare TipPose -->"),
        ({}, ("--config", "{folder}/none.toml"), "none.toml"),
    ],
    ids=["key", "task", "policy", "scene", "markers", "file"],
)
def test_mistakes_are_named_before_anything_runs(tmp_path, catalogue, module, monkeypatch, capsys, changes, arguments, said):
    (tmp_path / "docs.md").write_text("no markers")
    given = ("--config", write_config(tmp_path, **changes), *(argument.format(folder=tmp_path) for argument in arguments))
    with pytest.raises(SystemExit):
        main(module, monkeypatch, *given, "--out", tmp_path / "results")
    assert said in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("path", sorted((AGENTS.parent / "configs").glob("compare*.toml")), ids=lambda path: path.stem)
def test_shipped_configs_are_valid(path, module):
    table = tomllib.loads(path.read_text())
    settings = module("compare").Comparison.parse(table, path.name)
    assert table and settings.model_dump(mode="json").items() >= table.items(), "as it stands there"


def test_policies_whose_episodes_differ_are_not_compared(tmp_path, ppo, catalogue, module, monkeypatch, capsys):
    beside = ppo.with_name("config.json")
    beside.write_text(json.dumps({"options": {**SMALL, "control_period": 0.01, "preview": [0.1, 0.2]}}))
    given = ("--config", write_config(tmp_path), "--task", "TipPose", "--policies", "far", ppo, "--errors", "nominal", "--out", tmp_path)
    try:
        with pytest.raises(SystemExit):
            main(module, monkeypatch, *given)
        assert "has control_period = " in capsys.readouterr().err
        main(module, monkeypatch, *given, "--options", '{"control_period": 0.02}')
    finally:
        beside.unlink()
    results = json.loads((tmp_path / "TipPose.json").read_text())["results"]
    assert [result["policy"] for result in results] == ["far", str(ppo)]


def summary(**changes):
    values = {
        "episodes": 20,
        "diverged": 0,
        "errors": {"position_error": ErrorScore(0.0123, 0.02), "angle_error": ErrorScore(math.radians(3.0), 0.1)},
        "worst": {"position_error": 0.1, "angle_error": 0.1},
        "settled": 0,
        "settling_time": None,
        "effort": 5.0,
        "tension_rate": 1234.0,
        "bound_violations": 0,
        "mean_return": 400.0,
        "reached": None,
        "action_time": ActionTime(0.002, 0.004),
    }
    return Summary(**{**values, **changes})


def test_tables_flag_what_diverged(module):
    tables = module("_tables")
    well, badly = {("a", "nominal"): summary()}, {("a", "nominal"): summary(diverged=1)}
    assert "12.3 / 3.00 |" in tables.error_table(well) and "!" not in tables.error_table(well)
    assert "12.3 ! / 3.00 !" in tables.error_table(badly) and tables.LEGEND in tables.error_table(badly)
    full = tables.full_table("policy", {"a": summary(diverged=1)})
    assert "400.0 ! | 1/20" in full, "beside the return"
    assert tables.LEGEND in full


def test_every_number_is_shown_for_the_arm_of_the_model(module):
    tables = module("compare").tables_of
    noise, nominal = (("a", "noise"), summary()), (("a", "nominal"), summary())
    assert "policy (nominal)" in tables(dict([noise, nominal]))
    assert "policy (noise)" in tables(dict([noise]))


@pytest.mark.parametrize(
    "value, text", [(None, "-"), (math.nan, "-"), (12.34, "12.3"), (20.0, "20.0"), (999.7, "1000"), (123.4, "123"), (12345.6, "12346")]
)
def test_numbers_have_three_digits(module, value, text):
    assert module("_tables").number(value) == text


def test_what_is_not_finite_becomes_null(tmp_path, module):
    module("_records").write_json(tmp_path / "a.json", {"a": [math.inf, 1.0], "b": {"c": (math.nan,)}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [None, 1.0], "b": {"c": [None]}}
