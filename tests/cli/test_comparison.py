"""Several policies, and several seeds of one, on the same episodes, and their tables."""

import csv
import json
import re
import shutil

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, comparison, entrants, settings
from soft_tendon_env.policies.agent import save_agent

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
ARM = [f"{key}={value}" for key, value in SMALL.items()]


@pytest.fixture
def runs(tmp_path):
    """A folder of two runs, as `soft-tendon sweep` leaves it: the agents have learned nothing, each
    in another way."""
    from stable_baselines3 import PPO

    agent = PPO(
        "MlpPolicy",
        gym.make(IDS["TipPose"], **SMALL),
        n_steps=8,
        batch_size=4,
        seed=0,
        device="cpu",
    )
    for seed in (2, 10):
        run = tmp_path / "ppo_tip_pose" / f"seed_{seed}"
        (run / "best").mkdir(parents=True)
        config = {"task": "TipPose", "algorithm": "PPO", "seed": seed, "options": SMALL}
        (run / "config.json").write_text(json.dumps(config))
        if seed == 2:
            agent.policy.action_net.bias.data[:] = 0.3
        else:
            agent.policy.action_net.bias.data[:] = -0.3
        files = save_agent(run / "best", agent.policy, None)
        (run / "best" / "config.json").write_text(json.dumps({**config, "files": files}))
    return tmp_path / "ppo_tip_pose"


@pytest.mark.slow
def test_model_errors_that_are_given_together_are_drawn_together(tmp_path, command):
    both = "tension-10%,latency-20ms"
    short = ("--episodes", "2", "--seconds", "0.2", "--skip", "0.1")
    given = (
        "--task",
        "Shape",
        "--policies",
        "feedforward",
        "tracking",
        "--errors",
        "nominal",
        both,
        *short,
    )
    command(
        "compare",
        *given,
        "--set",
        *ARM,
        "control_period=0.04",
        "randomize.payload=[0, 0.1]",
        "--out",
        tmp_path,
    )
    record = json.loads((tmp_path / "Shape.json").read_text())
    results = record["results"]
    assert [(result["policy"], result["model_error"]) for result in results[:2]] == [
        ("feedforward", "nominal"),
        ("feedforward", both),
    ]
    assert [[episode["seed"] for episode in result["episodes"]] for result in results] == [
        list(EVALUATION_SEEDS[:2])
    ] * 4
    assert {episode["steps"] for result in results for episode in result["episodes"]} == {5}
    assert results[1]["summary"]["metrics"]["effort"] < results[0]["summary"]["metrics"]["effort"]
    assert record["settings"]["episodes"] == 2
    assert record["environments"]["tracking"]["fidelity"] == "fast"


@pytest.mark.slow
def test_a_folder_of_runs_is_one_policy(tmp_path, runs, capsys, command):
    files = [runs / f"seed_{seed}" / "best" for seed in (2, 10)]
    out = tmp_path / "out"
    given = (
        "--errors",
        "nominal",
        "--episodes",
        "2",
        "--seconds",
        "0.2",
        "--skip",
        "0.1",
        "--out",
        out,
    )
    command("compare", "--task", "TipPose", "--policies", "feedforward", runs, *files, *given)
    results = {
        result["policy"]: result
        for result in json.loads((out / "TipPose.json").read_text())["results"]
    }
    assert list(results) == ["feedforward", str(runs), *map(str, files)]
    assert results[str(runs)]["episodes"] == [
        episode for file in files for episode in results[str(file)]["episodes"]
    ]
    assert f"{runs} (2 seeds) " in capsys.readouterr().out
    rows = {
        row["policy"]: row for row in csv.DictReader((out / "TipPose.csv").read_text().splitlines())
    }
    low, value, high = (
        float(rows[str(runs)][f"position_error_rms{end}"]) for end in ("_low", "", "_high")
    )
    assert low < value < high
    assert (rows[str(runs)]["members"], rows[str(runs)]["episodes"]) == (
        "2",
        "4",
    )


def rewrite(run, **changes):
    path = run / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda runs: shutil.rmtree(runs), "no policy: it should be the folder of an agent"),
        (
            lambda runs: rewrite(runs / "seed_10", task="Shape"),
            "seed_10 has task = 'Shape', not 'TipPose'",
        ),
        (
            lambda runs: rewrite(runs / "seed_10", algorithm="SAC"),
            "seed_10 has algorithm = 'SAC', not 'PPO'",
        ),
        (lambda runs: shutil.rmtree(runs / "seed_10" / "best"), "seed_10 has no agent in best"),
        (
            lambda runs: (runs / "seed_2" / "config.json").unlink(),
            "seed_2 is no run: it has no config.json",
        ),
    ],
    ids=["missing", "task", "algorithm", "unfinished", "no run"],
)
def test_folders_that_are_no_sweep(runs, spoil, said):
    spoil(runs)
    with pytest.raises((ValueError, OSError), match=re.escape(said)):
        comparison.shared_arms(
            settings.EpisodeSettings(), "TipPose", entrants.agents_of("TipPose", [str(runs)])
        )
