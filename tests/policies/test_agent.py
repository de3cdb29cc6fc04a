"""Trained agents as policies: what is found in their files, and what is refused."""

import json
import os
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
import sb3_contrib
import stable_baselines3
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.policies import agent
from soft_tendon_env.policies.agent import OF_TRAINING, AgentConfig, read_config
from soft_tendon_env.policies.names import load_policy, policy_options
from soft_tendon_env.policies.normalization import STATISTICS, normalization_of
from soft_tendon_env.policies.trained_arm import numbers_outside
from soft_tendon_env.policies.weights import WEIGHTS, acting_arrays, read_weights
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.files import digest

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


def make(task="TipPose", **options):
    return gym.make(
        IDS[task], **{**SMALL, "action": "tension", **options}
    )  # as agents have it whose files do not say it


def write_agent(folder, network, normalization=None, **config):
    folder.mkdir(exist_ok=True)
    files = agent.save_agent(folder, network, normalization)
    (folder / "config.json").write_text(
        json.dumps({"algorithm": "PPO", "options": SMALL, "files": files, **config})
    )
    return folder


def sign(folder):
    """Writes the digests of the files as they are into the configuration."""
    path = folder / "config.json"
    files = {
        name: digest(folder / name) for name in (WEIGHTS, STATISTICS) if (folder / name).is_file()
    }
    path.write_text(json.dumps({**json.loads(path.read_text()), "files": files}))


@pytest.mark.parametrize("name", [WEIGHTS, STATISTICS])
def test_files_without_a_digest_are_refused(tmp_path, trained, name):
    folder = write_agent(tmp_path / "agent", *trained)
    path = folder / "config.json"
    config = json.loads(path.read_text())
    kept = config["files"].pop(name)
    path.write_text(json.dumps(config))
    with pytest.raises(ValueError, match=f"has no digest of {name}") as error:
        agent.load_agent(str(folder), make())
    assert f'"files": {{"{name}": "{kept}"}}' in str(error.value)
    (folder / name).write_bytes((folder / name).read_bytes() + b"more")
    sign(folder)
    config = json.loads(path.read_text())
    path.write_text(json.dumps({**config, "files": {**config["files"], name: kept}}))
    with pytest.raises(ValueError, match=f"{name} is not the file that .* was written with"):
        agent.load_agent(str(folder), make())


@pytest.mark.parametrize("name", ["PPO", "SAC", "TQC"])
def test_an_agent_of_any_algorithm_acts_as_its_model(tmp_path, name):
    algorithm = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    trained = algorithm("MlpPolicy", make(), device="cpu", seed=0)
    env = make()
    observation, _ = env.reset(seed=0)
    loaded = agent.load_agent(
        str(write_agent(tmp_path / "own", trained.policy, algorithm=name)), env
    )
    action, _ = loaded.predict(observation, None, np.ones(1, bool), deterministic=True)
    np.testing.assert_allclose(
        action, trained.predict(observation, deterministic=True)[0], atol=1e-5
    )


@pytest.mark.parametrize("task", ["TipPose", "Reach"])
def test_an_agent_sees_through_its_statistics(tmp_path, task):
    statistics = VecNormalize(DummyVecEnv([lambda: make(task)]), clip_obs=3.0)
    trained = SAC(
        "MultiInputPolicy" if task == "Reach" else "MlpPolicy",
        statistics,
        learning_starts=40,
        seed=0,
        device="cpu",
    ).learn(60)
    env = make(task)
    observation, _ = env.reset(seed=0)
    config = {"algorithm": "SAC", "normalise": {"observations": True}}
    folder = write_agent(tmp_path / "own", trained.policy, normalization_of(statistics), **config)
    action, _ = agent.load_agent(str(folder), env).predict(observation)
    np.testing.assert_allclose(
        action,
        trained.predict(statistics.normalize_obs(observation), deterministic=True)[0],
        atol=1e-5,
    )
    (folder / "statistics.npz").unlink()
    sign(folder)
    with pytest.raises(
        FileNotFoundError,
        match="should have statistics.npz: the agent sees observations through it",
    ):
        agent.load_agent(str(folder), env)


@pytest.fixture(scope="module")
def trained():
    """A network of PPO that has hardly learned, and the statistics that it sees through."""
    statistics = VecNormalize(DummyVecEnv([make]))
    model = PPO(
        "MlpPolicy", statistics, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu"
    ).learn(64)
    return model.policy, normalization_of(statistics)


class Malice:
    """An object that makes a folder where it is unpickled."""

    def __init__(self, folder):
        self.folder = str(folder)

    def __reduce__(self):
        return os.mkdir, (self.folder,)


@pytest.mark.parametrize("name", ["weights.npz", "statistics.npz", "config.json"])
def test_what_is_pickled_in_an_agents_files_does_not_run(tmp_path, trained, name):
    folder = write_agent(tmp_path / "agent", *trained)
    ran = tmp_path / "it_ran"
    agent.load_agent(str(folder), make())
    (folder / name).write_bytes(pickle.dumps(Malice(ran)))
    if name != "config.json":
        sign(folder)
    with pytest.raises(ValueError, match=f"{folder / name}") as error:
        agent.load_agent(str(folder), make())
    assert not ran.exists()
    assert len(str(error.value).splitlines()) == 1


def test_objects_among_an_agents_arrays_are_not_unpickled(tmp_path, trained):
    folder = write_agent(tmp_path / "agent", *trained)
    ran = tmp_path / "it_ran"
    weights = {**read_weights(folder / WEIGHTS), BIAS: np.array([Malice(ran)])}
    np.savez(folder / WEIGHTS, **weights)
    sign(folder)
    with pytest.raises(ValueError, match="weights.npz holds no weights alone"):
        agent.load_agent(str(folder), make())
    assert not ran.exists()


def test_weights_of_an_earlier_version_are_named(tmp_path, trained):
    folder = write_agent(tmp_path / "agent", *trained)
    (folder / WEIGHTS).rename(folder / "weights.pt")
    with pytest.raises(FileNotFoundError, match="weights.pt is of an earlier version"):
        agent.load_agent(str(folder), make())


BIAS = "action_net.bias"


def weights(change):
    def write(folder, network, normalization):
        changed = change(acting_arrays(network.state_dict()))
        np.savez(folder / "weights.npz", **changed)

    return write


def one_array(folder, network, normalization):
    with open(folder / "weights.npz", "wb") as file:
        np.save(file, np.zeros(3))


def arrays(**changes):
    def write(folder, network, normalization):
        moments = normalization.moments[""]
        values = {
            "mean": moments.mean,
            "variance": moments.variance,
            "clip": np.float64(10.0),
            "epsilon": np.float64(1e-8),
            **changes,
        }
        np.savez(
            folder / "statistics.npz",
            **{key: value for key, value in values.items() if value is not None},
        )

    return write


def table(**changes):
    def write(folder, network, normalization):
        path = folder / "config.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return write


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            weights(lambda found: {**found, BIAS: np.float32(np.nan) * found[BIAS]}),
            f"weights.npz has weights that are not finite, in {BIAS}",
        ),
        (
            weights(lambda found: found.pop(BIAS) is None or found),
            f"weights.npz: the weights are not of a PPO policy for this env.*: {BIAS} is missing,"
            r" which should be of shape \(3,\)",
        ),
        (
            weights(lambda found: {**found, BIAS: found[BIAS][:2]}),
            rf"not of a PPO policy .*: {BIAS} is of shape \(2,\): it should be \(3,\)",
        ),
        (
            weights(lambda found: {**found, BIAS: found[BIAS].astype(float)}),
            f"weights.npz: {BIAS} is of type float64: it should be float32",
        ),
        (
            weights(lambda found: {**found, "lstm.weight": found[BIAS]}),
            "not of a PPO policy .*: lstm.weight should not be there",
        ),
        (one_array, "weights.npz holds no weights alone"),
        (
            arrays(mean=np.zeros(3), variance=np.ones(3)),
            r"statistics.npz is of observations \(3,\), this environment has",
        ),
        (arrays(mean=None), "statistics.npz should have mean, variance, clip and epsilon alone"),
        (arrays(clip=None), "statistics.npz is no .npz file of mean, variance, clip and epsilon"),
        (arrays(clip=np.float64(np.nan)), "statistics.npz should have .* alone: finite numbers"),
        (arrays(variance=-np.ones(48)), "statistics.npz should have .* variances of at least 0"),
        (
            table(algorithm="PPOO"),
            "config.json: algorithm is 'PPOO': it should be an algorithm: did you mean 'PPO'",
        ),
        (table(algorithm="SAC"), "weights.npz: the weights are not of a SAC policy"),
        (table(residual="tracking"), "config.json: residual is an unknown key"),
        (
            table(hyperparameters={"policy_kwargs": {"net_archs": [7]}}),
            "policies of PPO have no argument net_archs",
        ),
        (
            table(hyperparameters={"policy_kwargs": {"activation_fn": "os.system"}}),
            "activation_fn is 'os.system'",
        ),
        (
            table(hyperparameters={"policy_kwargs": {"features_extractor_class": "Mine"}}),
            "features_extractor_class is 'Mine': layers of one's own cannot act here",
        ),
        (
            table(hyperparameters={"policy_kwargs": {"net_arch": [64, "64"]}}),
            "net_arch is .*: it should be the units of hidden layers",
        ),
    ],
)
def test_an_agent_that_is_none_is_refused_in_one_line(tmp_path, trained, spoil, said):
    folder = write_agent(tmp_path / "agent", *trained)
    spoil(folder, *trained)
    sign(folder)
    with pytest.raises(ValueError, match=said) as error:
        agent.load_agent(str(folder), make())
    assert str(folder) in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_keys_of_the_training_alone_are_left_out(tmp_path, trained):
    folder = write_agent(tmp_path / "own", *trained, **dict.fromkeys(OF_TRAINING))
    config = read_config(folder)
    assert config == AgentConfig(algorithm="PPO", options=SMALL, files=config.files)


def untrained_agent(folder, **config):
    """The folder of an agent of PPO that has learned nothing."""
    network = PPO(
        "MlpPolicy", make(**config["options"]), n_steps=8, batch_size=4, seed=0, device="cpu"
    ).policy
    return str(
        write_agent(folder, network, **{**config, "options": {**SMALL, **config["options"]}})
    )


@pytest.fixture
def ppo(tmp_path):
    options = {"action": "increment"}
    return untrained_agent(
        tmp_path / "ppo",
        options=options,
        layout=agent.layout_of(make(**options).unwrapped.episodes),
    )


@pytest.mark.parametrize(
    ("task", "options", "said"),
    [
        ("TipPose", {"observation": ["rates", "coordinates"]}, "was trained with observation = "),
        ("TipPose", {"preview": []}, "was trained with observation = "),
        ("TipPose", {"preview": [0.02, 0.04]}, "was trained with preview = "),
        ("TipPose", {"action": "tension"}, "was trained with action = "),
        ("TipPose", {"scene": "paper"}, "was trained on an arm with other segments"),
        (
            "TipPose",
            {"scene": {"scene": "three_tendon", "segments[0].young_modulus": 1e5}},
            "was trained on an arm with other segments",
        ),
        (
            "TipPose",
            {"scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0, 0, -9.81]}},
            "with other effects",
        ),
        (
            "TipPose",
            {"control_period": 0.01},
            "was trained with control_period = 0.02, this environment has 0.01",
        ),
        (
            "TipPose",
            {"control_period": 0.3},  # whose usual preview is another one too
            "was trained with control_period = 0.02, this environment has 0.3",
        ),
    ],
)
def test_an_agent_is_refused_elsewhere(ppo, task, options, said):
    agent.load_agent(ppo, make(action="increment"))
    with pytest.raises(ValueError, match=said):
        agent.load_agent(ppo, make(task, **{"action": "increment", **options}))


@pytest.mark.parametrize("period", [0.3, 0.15])
def test_another_control_period_is_refused_by_its_name(ppo, period):
    """Before the preview of the training, which may be less than half of it."""
    with pytest.raises(ValueError, match=rf"trained with control_period = 0.02, .* is {period}"):
        policy_options(ppo, "TipPose", {"control_period": period})
    assert policy_options(ppo, "TipPose", {"control_period": 0.02})["control_period"] == 0.02


DRAWN_ARMS = {
    "scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, 0.0]},
    "randomize": {
        "stiffness": [0.8, 1.2],
        "payload": [0.0, 0.02],
        "effects.gravity.acceleration": [[-2.0, 2.0]] * 3,
    },
}
"""A training on arms of 0.4 to 0.6 MPa, with gravity and payloads."""


@pytest.mark.parametrize(
    ("changes", "own", "loads"),
    [
        ({}, [], []),
        ({"segments.0.young_modulus": 6e5}, [], []),
        (
            {"segments.0.young_modulus": 6.1e5},
            ["segments.0.young_modulus is 610000, in its training 400000 to 600000"],
            [],
        ),
        ({"segments.0.damping": 8.1e3}, ["segments.0.damping is 8100, in its training 8000"], []),
        ({"effects.tip_load.mass": 0.02}, [], []),
        (
            {"effects.tip_load.mass": 0.03},
            [],
            ["effects.tip_load.mass is 0.03, in its training 0 to 0.02"],
        ),
        (
            {"effects.tip_load.force": [0.0, 0.1, 0.0]},
            [],
            ["effects.tip_load.force.1 is 0.1, in its training 0"],
        ),
        (
            {"effects.gravity.acceleration": [0.0, 0.0, -9.81]},
            [],
            ["effects.gravity.acceleration.2 is -9.81, in its training -2 to 2"],
        ),
        (
            {"effects.fluid.density": 1000.0},
            ["effects.fluid.density is 1000, in its training absent"],
            [],
        ),
    ],
)
def test_numbers_of_an_arm_outside_of_a_training_are_named(changes, own, loads):
    trained = Options(**SMALL | DRAWN_ARMS)
    scene = load_scene("three_tendon").replace(changes)
    outside = numbers_outside(trained, scene)
    found = {str(number) for number in outside if not number.is_load}
    assert {*own} <= found
    assert bool(own) == bool(found)
    assert [str(number) for number in outside if number.is_load] == loads


def test_an_agent_acts_beyond_its_training_if_it_is_told_to(tmp_path):
    options = {"action": "increment", **LOOKS}
    folder = untrained_agent(tmp_path / "own", options=options)
    softer = make(**options, scene={"scene": "three_tendon", "segments.0.young_modulus": 1e5})
    with pytest.raises(
        ValueError, match=r"young_modulus is 100000, in its training 500000\. Train"
    ):
        agent.load_agent(folder, softer)
    with pytest.warns(agent.TrainingWarning, match="young_modulus is 100000, in its training"):
        agent.load_agent(folder, softer, beyond_training=True)
    longer = {"scene": "three_tendon", "tendons.0.tension_limits": [0.0, 9.0]}
    with pytest.raises(ValueError, match=r"other tendons .*: tendons.0.tension_limits.1 is 9, in"):
        agent.load_agent(folder, make(**options, scene=longer))


LOOKS = {"observation": ["target_error"]}
DRAWN = {"randomize": {"effects.gravity.acceleration": [[-9.0, 9.0]] * 3}}


def gravity(acceleration):
    return {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, acceleration]}


@pytest.mark.parametrize(
    ("task", "trained", "judged", "said"),
    [
        ("TipPose", {}, {}, None),
        (
            "TipPose",
            {**LOOKS, "scene": gravity(0.0), **DRAWN},
            LOOKS,
            None,
        ),  # whether it is drawn or not there
        (
            "TipPose",
            {**LOOKS, "scene": gravity(0.0), **DRAWN},
            {**LOOKS, "scene": gravity(-9.81)},
            "trained with scene = ",
        ),
        (
            "TipPose",
            LOOKS,
            {**LOOKS, "fidelity": "standard"},
            "trained with fidelity = 'fast', judged with",
        ),
        ("TipPose", {}, {"scene": load_scene("three_tendon")}, None),  # the same in other words
        ("Shape", {}, {}, "trained with task = 'Shape', judged with 'TipPose'"),
    ],
)
def test_an_agent_says_once_it_is_loaded_that_it_was_trained_otherwise(
    tmp_path, task, trained, judged, said
):
    usual = {"action": "increment", "preview": [0.1, 0.2]}
    folder = untrained_agent(tmp_path / "own", task=task, options={**usual, **trained})
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", agent.TrainingWarning)
        load_policy(folder, make(**usual, **judged))
    texts = [str(warning.message) for warning in found if warning.category is agent.TrainingWarning]
    assert len(texts) == (said is not None)
    assert all(f"{said}" in text and "policy_options()" in text for text in texts)


def test_agents_are_those_of_their_folders_and_of_the_repository(tmp_path, monkeypatch):
    """Of a wheel that has an agent near by and knows of one that it lacks."""
    table = ['TipPose = "near"', "[repository_alone]", 'TipPose = ["far"]', "Reach = []"]
    (tmp_path / "agents.toml").write_text("\n".join(table))
    folder = tmp_path / "near" / "TipPose"
    folder.mkdir(parents=True)
    (folder / WEIGHTS).write_bytes(b"")
    monkeypatch.setattr(agent, "trained_folder", lambda: tmp_path)
    assert agent.shipped() == ("agent", "far", "near")
    assert agent.is_shipped("far")
    assert agent.shipped_as("agent", "TipPose") == "near"
    with pytest.raises(FileNotFoundError, match="'far' for TipPose is not in a wheel"):
        agent.shipped_as("far", "TipPose")
    with pytest.raises(FileNotFoundError, match="'far' does not ship for Reach; what does: none"):
        agent.shipped_as("far", "Reach")
