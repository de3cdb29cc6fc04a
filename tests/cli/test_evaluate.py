"""`soft-tendon evaluate` as a user runs it, and the policies that it finds by their names."""

import json

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, Entry
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS
from soft_tendon_env.policies import load

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
        assert result["summary"]["diverged"] == 0 and not result["summary"]["flagged"]
        assert 0.0 < result["summary"]["action_time"]["median"] <= result["summary"]["action_time"]["percentile_99"]
        effort[result["model_error"]] = result["summary"]["effort"]
    assert effort["tension+10%"] == pytest.approx(1.1 * effort["nominal"], rel=0.02)
    configuration = json.loads(png.with_suffix(".configuration.json").read_text())
    (environment,) = configuration["environments"]
    assert environment["options"]["scene"] == "three_tendon", "from config.json"
    assert environment["options"]["randomize"]["payload"] == [0.0, 0.0], "what an agent trained with is not what it is judged on"
    assert configuration["settings"]["seconds"] == 0.2 and configuration["versions"]["soft_tendon_env"]


def test_a_controller_is_found_in_the_catalogue_with_what_it_looks_at(small, pulling, monkeypatch):
    monkeypatch.setitem(CONTROLLERS["TipPose"], "still", Entry("pulls", pulling(0.2), looks_ahead=3))
    options = load.policy_options("still", "TipPose", {**small, "control_period": 0.01})
    assert options["preview"] == pytest.approx([0.01, 0.02, 0.03])
    env = gym.make(IDS["TipPose"], **options)
    action, _ = load.load_policy("still", env).predict(env.reset(seed=0)[0])
    np.testing.assert_allclose(action, -0.6, rtol=1e-6)
    assert "still" in load.expand_policies("TipPose", ("all", "own.zip"))
    assert load.expand_policies("TipPose", ("own.zip",)) == ("own.zip",)
