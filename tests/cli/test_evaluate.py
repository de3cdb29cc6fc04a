"""`soft-tendon evaluate` as a user runs it."""

import json

import pytest

from soft_tendon_env.evaluation import EVALUATION_SEEDS

SHORT = ("--episodes", "2", "--seconds", "0.2", "--skip", "0.1")


def test_an_agent_is_evaluated_under_every_error_asked_for(tmp_path, agent, command, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command("evaluate", agent(randomize={"payload": 0.1}), *SHORT, "--errors", "nominal", "tension+10%")
    rows = [line.split("|")[1].strip() for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert rows[0] == "model error" and rows[2:] == ["nominal", "tension+10%"]
    (png,) = (tmp_path / "out" / "evaluate").glob("*.png")
    assert png.read_bytes().startswith(b"\x89PNG")
    results = json.loads(png.with_suffix(".json").read_text())["results"]
    effort = {}
    for result in results:
        assert [episode["seed"] for episode in result["episodes"]] == list(EVALUATION_SEEDS[:2])
        assert {episode["steps"] for episode in result["episodes"]} == {10}
        assert 0.0 < result["summary"]["errors"]["position_error"]["rms"] < 1.0
        assert result["summary"]["diverged"] == 0
        assert 0.0 < result["summary"]["action_time"]
        effort[result["model_error"]] = result["summary"]["metrics"]["effort"]
    assert effort["tension+10%"] == pytest.approx(1.1 * effort["nominal"], rel=0.02)
    record = json.loads(png.with_suffix(".json").read_text())
    (environment,) = record["environments"].values()
    assert environment["scene"] == "three_tendon", "from config.json"
    assert environment["randomize"]["numbers"] == {}, "what an agent trained with is not what it is judged on"
    assert record["settings"]["seconds"] == 0.2 and record["versions"]["soft_tendon_env"]
