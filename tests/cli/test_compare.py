"""`soft-tendon compare` as a user runs it, and what it does with several policies."""

import csv
import json
import math
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.control import CONTROLLERS, Entry
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import provenance, settings, tables
from soft_tendon_env.evaluation.metrics import ErrorScore
from soft_tendon_env.evaluation.summaries import Summary
from soft_tendon_env.policies.agent import save_agent

CONFIGS = Path(__file__).parent.parent.parent / "configs"
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
    """A folder of two runs, as `soft-tendon sweep` leaves it: the agents have learned nothing, each in its own way."""
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


@pytest.fixture
def catalogue(monkeypatch, pulling):
    """Two controllers for every task, and no other."""
    for entries in CONTROLLERS.values():
        for name in list(entries):
            monkeypatch.delitem(entries, name)
        monkeypatch.setitem(entries, "slack", Entry("does nothing", pulling(0.0)))
        monkeypatch.setitem(entries, "far", Entry("looks ahead", pulling(0.1), looks_ahead=2))


def write_config(folder, **changes):
    values = {"errors": ["nominal", "tension-10%"], "episodes": 2, "seconds": 0.2, "skip": 0.1, "workers": 1, **changes}
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    path = folder / "own.toml"
    path.write_text("\n".join([*lines, "[options]", *(f"{key} = {json.dumps(value)}" for key, value in SMALL.items())]))
    return path


def rows_of(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.slow  # every process loads torch
def test_an_agent_is_compared_with_itself_by_two_processes(tmp_path, ppo):
    other = shutil.copy(ppo, tmp_path / "other.zip")
    config = write_config(tmp_path, tasks=["TipPose"], policies=[str(ppo), str(other)], workers=2)
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, "-m", "soft_tendon_env", "compare", "--config", config]
    printed = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True).stdout
    assert sum(line.startswith((f"| {other}", f"| {ppo}")) for line in printed.splitlines()) == 4, "two tables of two policies"
    out = tmp_path / "out" / "compare"
    rows = rows_of(out / "TipPose.csv")
    assert [row["condition"] for row in rows] == ["nominal", "tension-10%"] * 2
    assert [row["position_error_rms"] for row in rows[:2]] == [row["position_error_rms"] for row in rows[2:]], "bit for bit"
    results = json.loads((out / "TipPose.json").read_text())["results"]
    assert [len(result["episodes"]) for result in results] == [2] * 4
    assert (out / "TipPose.png").read_bytes().startswith(b"\x89PNG")


def test_all_controllers_of_all_tasks_by_default(tmp_path, catalogue, capsys, command):
    docs = tmp_path / "docs.md"
    docs.write_text("\n".join(f"<!-- compare {task} -->\nold\n<!-- /compare {task} -->\nkept" for task in IDS))
    command("compare", "--config", write_config(tmp_path), "--out", tmp_path, "--write-docs", docs)
    printed, written = capsys.readouterr().out, docs.read_text()
    for task in IDS:
        assert f"## {task}" in printed
        results = json.loads((tmp_path / f"{task}.json").read_text())["results"]
        found = {(result["policy"], result["model_error"]): result["summary"] for result in results}
        assert set(found) == {(policy, error) for policy in ("slack", "far") for error in ("nominal", "tension-10%")}
        assert found["far", "tension-10%"]["metrics"]["effort"] == pytest.approx(0.9 * found["far", "nominal"]["metrics"]["effort"])
        assert found["slack", "nominal"]["errors"] == found["slack", "tension-10%"]["errors"], "nothing is nothing"
        assert (found["slack", "nominal"]["reached"] is None) == (task != "Reach")
        assert found["far", "nominal"]["action_time"] == found["far", "tension-10%"]["action_time"], "measured once"
        assert sum(line.startswith(("| slack ", "| far ")) and line.endswith("| controller        |") for line in printed.splitlines()) == 6
    for line in printed.splitlines():
        assert not line.startswith("|") or line in written
    assert "old" not in written and written.count("kept") == len(IDS)


def test_arguments_go_before_the_config_file(tmp_path, catalogue, command):
    config = write_config(tmp_path)
    only = ("--task", "Shape", "--policies", "far", "--errors", "nominal", "--episodes", "1", "--options", '{"control_period": 0.04}')
    command("compare", "--config", config, *only, "--out", tmp_path)
    (result,) = json.loads((tmp_path / "Shape.json").read_text())["results"]
    (episode,) = result["episodes"]
    assert (result["policy"], result["model_error"], episode["steps"]) == ("far", "nominal", 5)
    environment = json.loads((tmp_path / "Shape.json").read_text())["environments"]["far"]
    assert environment["preview"] == pytest.approx([0.04, 0.08]), "what the controller looks at, in its periods"
    assert environment["fidelity"] == "fast", "of the file, beside what was given"


def test_episodes_errors_and_options_are_given_on_the_command_line(tmp_path, catalogue, capsys, command):
    both, changes = "tension-10%,latency-20ms", ("randomize.payload=[0.0, 0.1]", "fidelity=fast")
    only = ("--task", "TipPose", "--policies", "far", "--errors", "nominal", both, "--seeds", "7", "2000000")
    command("compare", "--config", write_config(tmp_path), *only, "--set", *changes, "--out", tmp_path)
    said = capsys.readouterr()
    assert "2 episodes of" in said.out
    results = json.loads((tmp_path / "TipPose.json").read_text())["results"]
    found = {result["model_error"]: result for result in results}
    assert list(found) == ["nominal", both], "the file's others are not taken"
    assert [[episode["seed"] for episode in result["episodes"]] for result in results] == [[7, 2_000_000]] * 2
    assert found[both]["summary"]["metrics"]["effort"] < found["nominal"]["summary"]["metrics"]["effort"]
    record = json.loads((tmp_path / "TipPose.json").read_text())
    assert record["settings"]["seeds"] == [7, 2_000_000]
    assert record["environments"]["far"]["randomize"]["numbers"] == {"effects.tip_load.mass": {"offset": [0.0, 0.1]}}
    again = {key: record["settings"][key] for key in ("episodes", "seeds", "errors")}
    assert settings.Settings.parse(again, "record").seeds == (7, 2_000_000)


@pytest.mark.parametrize("path", [*CONFIGS.glob("compare*.toml")], ids=lambda path: path.stem)
def test_shipped_configs_are_valid(path):
    table = tomllib.loads(path.read_text())
    read = settings.Comparison.parse(table, path.name)
    assert table and read.model_dump(mode="json").items() >= table.items(), "as it stands there"


def test_policies_whose_episodes_differ_are_not_compared(tmp_path, ppo, catalogue, capsys, command):
    agents = []
    for period in (0.01, 0.02):
        agents.append(tmp_path / f"{period:g}" / "model.zip")
        agents[-1].parent.mkdir()
        shutil.copy(ppo, agents[-1])
        options = {**SMALL, "control_period": period, "preview": [0.1, 0.2]}
        agents[-1].with_name("config.json").write_text(json.dumps({"options": options}))
    given = ("--config", write_config(tmp_path), "--task", "TipPose", "--errors", "nominal", "--out", tmp_path)
    with pytest.raises(SystemExit):
        command("compare", *given, "--policies", "far", *agents)
    assert f"{agents[1]} has control_period = 0.02, {agents[0]} has 0.01: " in capsys.readouterr().err
    for policies, more, steps in ((agents, ("--options", '{"control_period": 0.02}'), 10), (agents[:1], (), 20)):
        command("compare", *given, "--policies", "far", *policies, *more)
        results = json.loads((tmp_path / "TipPose.json").read_text())["results"]
        assert [result["policy"] for result in results] == ["far", *map(str, policies)]
        assert {episode["steps"] for result in results for episode in result["episodes"]} == {steps}, "the agent's, unless given"


def test_a_folder_of_runs_is_one_policy(tmp_path, runs, catalogue, capsys, command):
    files = [runs / f"seed_{seed}" / "best" for seed in (2, 10)]
    config = write_config(tmp_path)
    command("compare", "--config", config, "--task", "TipPose", "--policies", "far", runs, *files, "--out", tmp_path / "out")
    printed = capsys.readouterr().out
    results = json.loads((tmp_path / "out" / "TipPose.json").read_text())["results"]
    nominal = {result["policy"]: result for result in results if result["model_error"] == "nominal"}
    assert list(nominal) == ["far", str(runs), *map(str, files)]
    assert nominal[str(runs)]["episodes"] == [episode for file in files for episode in nominal[str(file)]["episodes"]]
    assert any(f"{runs} (2 seeds) " in line for line in printed.splitlines())
    rows = {row["policy"]: row for row in rows_of(tmp_path / "out" / "TipPose.csv") if row["condition"] == "nominal"}
    low, value, high = (float(rows[str(runs)][f"position_error_rms{end}"]) for end in ("_low", "", "_high"))
    assert low < value < high and (rows[str(runs)]["members"], rows[str(runs)]["episodes"]) == ("2", "4")


def rewrite(run, **changes):
    path = run / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda runs: [shutil.rmtree(run) for run in runs.iterdir()], "a folder: it should be the folder of an agent"),
        (lambda runs: shutil.rmtree(runs), "no policy: it should be the folder of an agent"),
        (lambda runs: rewrite(runs / "seed_10", task="Shape"), "seed_10 has task = 'Shape', the first seed has 'TipPose'"),
        (lambda runs: rewrite(runs / "seed_10", algorithm="SAC"), "seed_10 has algorithm = 'SAC', the first seed has 'PPO'"),
        (lambda runs: shutil.rmtree(runs / "seed_10" / "best"), "seed_10 has no agent in best"),
        (lambda runs: (runs / "seed_2" / "config.json").unlink(), "seed_2 is no run: it has no config.json"),
    ],
    ids=["empty", "missing", "task", "algorithm", "unfinished", "no run"],
)
def test_folders_that_are_no_sweep(tmp_path, runs, catalogue, capsys, spoil, said, command):
    spoil(runs)
    with pytest.raises(SystemExit):
        command("compare", "--config", write_config(tmp_path), "--task", "TipPose", "--policies", runs, "--out", tmp_path / "out")
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_tables_flag_what_diverged():
    errors = {"position_error": ErrorScore(0.0123, 0.02), "angle_error": ErrorScore(math.radians(3.0), 0.1)}

    def table(diverged):
        summary = Summary(20, diverged, errors, 0, {"effort": 5.0, "chatter": 0.25}, 400.0, None, 0.002)
        return tables.summary_table("policy", {"a": summary}, {"a": "none"})

    assert "12.3 !" in table(1) and tables.LEGEND in table(1)
    headers = [name.strip() for name in table(0).splitlines()[0].split("|")[1:-1]]
    assert headers[:6] == ["policy", "position [mm] RMS", "angle [deg] RMS", "settled", "effort [N]", "chatter [N]"]
    assert headers[6:] == ["time [ms]", "model in the loop"]


@pytest.mark.cases(
    "value, text", [(None, "-"), (math.nan, "-"), (12.34, "12.3"), (20.0, "20.0"), (999.7, "1000"), (123.4, "123"), (12345.6, "12346")]
)
def test_numbers_have_three_digits(value, text):
    assert tables.number(value) == text


def test_what_is_not_finite_becomes_null(tmp_path):
    provenance.write_json(tmp_path / "a.json", {"a": [math.inf, 1.0], "b": {"c": (math.nan,)}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [None, 1.0], "b": {"c": [None]}}
