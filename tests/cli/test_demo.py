"""`soft-tendon demo` on a smaller arm, over short episodes, with an agent that has learned nothing."""

import json
import shutil

import pytest

from soft_tendon_env.evaluation import demo
from soft_tendon_env.policies import agent_files

POLICIES = ["paper (printed law)", "tracking (sampled law)", "predictive (MPC)", "agent (Stable-Baselines3)"]
SHORT = ("--episodes", "2", "--seconds", "0.2", "--workers", "1")


@pytest.fixture
def main(command, monkeypatch, small):
    """main(arguments): `soft-tendon demo` in this process."""
    monkeypatch.setattr(demo, "ARM", small)
    monkeypatch.setattr(demo, "shipped_for", lambda task: ())  # agents of another arm
    return lambda *arguments: command("demo", *arguments)


def test_all_policies_are_in_the_tables_the_picture_and_the_recording(main, agent, recorded, tmp_path, capsys):
    docs = tmp_path / "README.md"
    docs.write_text("before\n<!-- demo -->\nstale\n<!-- /demo -->\nafter\n")
    main("--agent", agent(), *SHORT, "--out", tmp_path, "--write-docs", docs)
    printed, written = capsys.readouterr().out, docs.read_text()
    lines = [line for line in printed.splitlines() if line.startswith("| ")]
    assert [line.split("|")[1].strip() for line in lines] == ["circle", *POLICIES, "2 random targets", *POLICIES]
    assert "kp = 10,000" in printed and "agent (Stable-Baselines3)" in printed and "cannot push" in printed
    assert all(line in written for line in lines) and "stale" not in written and written.endswith("after\n")
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    assert recorded(tmp_path / "demo.rrd") == dict.fromkeys(POLICIES, list(range(22))), "on the circle and on a random target"


@pytest.mark.slow  # every process loads torch
def test_two_processes_score_what_one_does(main, agent, tmp_path, capsys):
    def errors(workers):
        main("--agent", agent(), *SHORT[:-1], workers, "--out", tmp_path)
        lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
        return [line.split("|")[1:-3] for line in lines]  # all but times and models

    assert errors(1) == errors(2)


def test_ppo_is_shown_where_it_ships_and_once(monkeypatch, tmp_path):
    """As the best one too."""
    shipped = agent_files.trained_folder()
    monkeypatch.setattr(agent_files, "trained_folder", lambda: tmp_path)
    shutil.copy(shipped / "agents.toml", tmp_path)
    best = agent_files.read_toml(tmp_path / "agents.toml")["TipPose"]
    shutil.copytree(shipped / best / "TipPose", tmp_path / "dagger" / "TipPose")
    (tmp_path / "agents.toml").write_text('TipPose = "dagger"')
    names = ["paper", "tracking", "predictive"]
    assert [*demo.Demonstration().policies] == [*names, "agent"]
    shutil.copytree(tmp_path / "dagger" / "TipPose", tmp_path / "ppo" / "TipPose")
    config = tmp_path / "ppo" / "TipPose" / "config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {"algorithm": "PPO"}))
    shown = demo.Demonstration().policies
    assert [*shown] == [*names, "ppo", "agent"] and shown["ppo"] == "PPO"
    assert [*demo.Demonstration(agent="ppo").policies.items()][3:] == [("ppo", "agent (PPO)")]
