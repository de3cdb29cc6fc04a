"""Files of trainings that extend others: what is merged, what is replaced, and what is refused."""

import json
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.entrants import check_alike
from soft_tendon_env.learning.checkpoints import config_record
from soft_tendon_env.learning.config import find_config, read_table, read_training
from soft_tendon_env.policies.agent import CONFIG, trained_folder
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tuning.search import TrainingSearch

BASE = """
task = "TipPose"
algorithm = "APG"
steps = 1_000

[hyperparameters]
n_steps = 8
policy_kwargs = { memory = 4, fine = 10.0 }

[options]
scene = "three_tendon"
fidelity = "fast"
target = { type = "random", fraction = 0.4 }
preview = [0.02, 0.04]
"""


@pytest.fixture
def write(tmp_path):
    """Function that writes a file of this name and text, beside `base.toml`, and returns it."""

    def written(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return path

    written("base.toml", BASE)
    return written


def test_tables_are_merged_and_all_else_is_replaced(write):
    path = write(
        "mine.toml",
        """
        extends = "base.toml"
        steps = 2_000
        hyperparameters.policy_kwargs.memory = 8
        options.preview = [0.1]
        """,
    )
    assert read_table(path) == {
        "task": "TipPose",
        "algorithm": "APG",
        "steps": 2_000,
        "hyperparameters": {"n_steps": 8, "policy_kwargs": {"memory": 8, "fine": 10.0}},
        "options": {
            "scene": "three_tendon",
            "fidelity": "fast",
            "target": {"type": "random", "fraction": 0.4},
            "preview": [0.1],
        },
    }


def test_what_is_of_another_kind_is_replaced_as_a_whole(write):
    write("ppo.toml", 'extends = "base.toml"\nalgorithm = "PPO"')
    path = write(
        "mine.toml",
        """
        extends = "ppo.toml"
        algorithm = "SAC"
        hyperparameters.batch_size = 16
        options.target = { type = "circles" }
        """,
    )
    table = read_table(path)
    assert table["hyperparameters"] == {"batch_size": 16}
    assert table["options"]["target"] == {"type": "circles"}
    assert table["options"]["fidelity"] == "fast"


def test_paths_are_from_the_folder_of_the_file_and_chains_are_allowed(write):
    write("further/first.toml", 'extends = "../base.toml"\nsteps = 500')
    path = write("second.toml", 'extends = "further/first.toml"\narms = 4')
    training = read_training(path, ["hyperparameters.n_steps=16"], seed=3)
    assert (training.steps, training.arms, training.seed) == (500, 4, 3)
    assert training.hyperparameters["n_steps"] == 16
    dumped = training.model_dump(mode="json")
    assert "extends" not in dumped
    assert dumped["hyperparameters"]["policy_kwargs"] == {"memory": 4, "fine": 10.0}


def test_one_that_ships_is_extended_by_its_name(write):
    path = write("mine.toml", 'extends = "sac_tip_pose"\nsteps = 5')
    mine = read_training(path)
    shipped = read_training(find_config("sac_tip_pose"))
    assert mine == shipped.model_copy(update={"steps": 5})


def test_a_search_reads_what_its_training_extends(write):
    path = write("mine.toml", 'extends = "base.toml"\narms = 4')
    search = TrainingSearch(
        training=str(path), search={"hyperparameters.n_steps": {"choices": [8, 16]}}
    )
    assert search.file({"steps": 64}) == {**read_table(path), "steps": 64}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ('"apg_tip_pos"', "extends is 'apg_tip_pos': .*did you mean 'apg_tip_pose'"),
        ('"none.toml"', "extends is 'none.toml': it is neither a file, from the folder"),
        ("3", "extends is 3: it should be the name of a training"),
    ],
)
def test_what_cannot_be_extended_is_refused_with_file_and_key(write, given, message):
    path = write("mine.toml", f"extends = {given}")
    with pytest.raises(ConfigurationError, match=f"mine.toml: {message}") as refused:
        read_training(path)
    assert refused.value.source == str(path)


def test_a_circle_is_named(write):
    write("first.toml", 'extends = "second.toml"')
    write("second.toml", 'extends = "third.toml"')
    path = write("third.toml", 'extends = "first.toml"')
    with pytest.raises(ConfigurationError, match="cannot extend itself") as refused:
        read_training(path)
    (line,) = str(refused.value).splitlines()
    assert line.startswith(str(path.with_name("second.toml")) + ": extends is 'third.toml'")
    assert line.count("third.toml") == 3


def test_a_mistake_of_the_extended_file_is_said_with_its_name(write):
    write("base.toml", "steps = ")
    path = write("mine.toml", 'extends = "base.toml"')
    with pytest.raises(ConfigurationError, match="base.toml: is not valid TOML"):
        read_training(path)


def test_another_seed_of_a_further_training_compares_with_those_that_ship(tmp_path):
    """Its record has nothing of the training that it extends but what its own cost reads."""
    training = read_training(find_config("apg_tip_pose_smooth"), seed=5)
    envs = gym.make_vec(IDS["TipPose"], num_envs=1, threads=1, **training.options)
    record = config_record(training, envs.unwrapped.episodes)
    (tmp_path / CONFIG).write_text(json.dumps(record))
    fifth = trained_folder() / "apg" / "TipPose" / "seed_4"
    check_alike([fifth, tmp_path], "TipPose")
    record["hyperparameters"]["angle_scale"] = 0.05
    (tmp_path / CONFIG).write_text(json.dumps(record))
    with pytest.raises(ValueError, match="has hyperparameters = .*: compare it apart"):
        check_alike([fifth, tmp_path], "TipPose")


SCALED = (
    'extends = "base.toml"\nhyperparameters.angle_scale = 0.1\nhyperparameters.smoothness = 2.0'
)
"""A training with a hyperparameter that the errors alone read, and one that every cost reads."""


def test_what_a_cost_does_not_read_of_the_extended_file_is_left_out(write):
    write("scaled.toml", SCALED)
    path = write("mine.toml", 'extends = "scaled.toml"\nhyperparameters.cost = "reward"')
    further = write("further.toml", 'extends = "mine.toml"\nsteps = 5')
    scaled = read_training(path.with_name("scaled.toml")).hyperparameters
    assert scaled["angle_scale"] == 0.1
    for file in (path, further):
        by_reward = read_training(file).hyperparameters
        assert scaled.keys() - by_reward.keys() == {"angle_scale"}
        assert by_reward["smoothness"] == 2.0


def test_an_extended_file_that_sets_what_its_own_cost_does_not_read_is_refused(write):
    write("scaled.toml", SCALED + '\nhyperparameters.cost = "reward"')
    path = write("mine.toml", 'extends = "scaled.toml"\nsteps = 5')
    with pytest.raises(ConfigurationError, match="angle_scale is 0.1: it should be left out"):
        read_training(path)


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        ('hyperparameters.cost = "reward"\nhyperparameters.far_weight = 0.2', ()),
        ('hyperparameters.cost = "reward"', ["hyperparameters.far_weight=0.2"]),
        ("hyperparameters.far_weight = 0.2", ["hyperparameters.cost=reward"]),
    ],
    ids=["file", "set", "set cost"],
)
def test_what_a_cost_does_not_read_is_refused_where_a_user_sets_it(write, text, changes):
    path = write("mine.toml", f'extends = "base.toml"\n{text}')
    with pytest.raises(ConfigurationError) as refused:
        read_training(path, changes)
    source = f"{path}, changed" if changes else str(path)
    assert str(refused.value) == (
        f"{source}: hyperparameters.far_weight is 0.2: it should be left out with cost = 'reward',"
        " which does not read it; cost = 'errors' does"
    )
