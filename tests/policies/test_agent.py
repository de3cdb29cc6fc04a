"""Trained agents as policies: what is found in their files, and what is refused."""

import base64
import json
import pickle
import warnings
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import sb3_contrib
import stable_baselines3
import torch
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.policies import agent
from soft_tendon_env.policies.agent_checks import TrainingWarning, caveats, layout_of
from soft_tendon_env.policies.agent_files import find_agent, read_config
from soft_tendon_env.policies.load import load_policy, policy_options
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.policies.normalization import normalization_of, save_normalization
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


def make(task="TipPose", **options):
    return gym.make(IDS[task], **{**SMALL, **options})


def ppo_with_statistics():
    """An agent of PPO that has hardly learned, and the statistics that it sees through."""
    statistics = VecNormalize(DummyVecEnv([make]))
    return PPO("MlpPolicy", statistics, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu").learn(64), statistics


@pytest.mark.parametrize("name", ["A2C", "PPO", "SAC", "TD3", "TQC", "TRPO", "CrossQ", "RecurrentPPO"])
def test_the_algorithm_is_found_from_the_file(tmp_path, name):
    own = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    trained = own("MlpLstmPolicy" if name == "RecurrentPPO" else "MlpPolicy", make(), device="cpu", seed=0)
    trained.save(tmp_path / "model.zip")
    assert Agent(str(tmp_path / "model.zip"), "TipPose").algorithm == name
    env = make()
    observation, _ = env.reset(seed=0)
    action, _ = agent.load_agent(str(tmp_path / "model.zip"), env).predict(observation, None, np.ones(1, bool), deterministic=True)
    np.testing.assert_array_equal(action, trained.predict(observation, deterministic=True)[0])


NETWORKS = [{"net_arch": [8], "activation_fn": "ReLU"}, {"net_arch": {"pi": [8, 4], "vf": [5]}}, {"use_sde": True}]


@pytest.mark.parametrize("policy", NETWORKS, ids=str)
def test_the_network_is_that_of_the_training(tmp_path, policy):
    given = {**policy, **({"activation_fn": getattr(torch.nn, policy["activation_fn"])} if "activation_fn" in policy else {})}
    use_sde = given.pop("use_sde", False)
    trained = PPO("MlpPolicy", make(), policy_kwargs=given, use_sde=use_sde, seed=0, device="cpu")
    trained.save(tmp_path / "model.zip")
    own = {"policy_kwargs": {key: value for key, value in policy.items() if key != "use_sde"}, "use_sde": use_sde}
    write_agent(tmp_path / "own", trained.policy, None, hyperparameters=own)
    env = make()
    observation, _ = env.reset(seed=0)
    for name in ("model.zip", "own"):
        action, _ = agent.load_agent(str(tmp_path / name), env).predict(observation)
        np.testing.assert_array_equal(action, trained.predict(observation, deterministic=True)[0])


def write_agent(folder, network, normalization, **config):
    folder.mkdir()
    agent.save_agent(folder, network, normalization)
    (folder / "config.json").write_text(json.dumps({"algorithm": "PPO", "options": SMALL, **config}))
    return folder


@pytest.mark.parametrize("task", ["TipPose", "Reach"])
def test_an_agent_sees_through_its_statistics(tmp_path, task):
    statistics = VecNormalize(DummyVecEnv([lambda: make(task)]), clip_obs=3.0)
    trained = SAC("MultiInputPolicy" if task == "Reach" else "MlpPolicy", statistics, learning_starts=40, seed=0, device="cpu").learn(60)
    trained.save(tmp_path / "model.zip")
    env = make(task)
    observation, _ = env.reset(seed=0)
    with pytest.raises(FileNotFoundError, match="should have its statistics.npz beside it"):
        agent.load_agent(str(tmp_path / "model.zip"), env)
    (tmp_path / "config.json").write_text(json.dumps({"normalise": {"observations": False}}))
    raw, _ = agent.load_agent(str(tmp_path / "model.zip"), env).predict(observation)
    save_normalization(tmp_path / "statistics.npz", normalization_of(statistics))
    own = write_agent(tmp_path / "own", trained.policy, normalization_of(statistics), algorithm="SAC")
    for path in (tmp_path / "model.zip", own):
        action, _ = agent.load_agent(str(path), env).predict(observation)
        np.testing.assert_array_equal(action, trained.predict(statistics.normalize_obs(observation), deterministic=True)[0])
        assert not np.array_equal(action, raw)


def test_a_folder_with_a_zip_file_alone_is_refused_by_its_name(tmp_path):
    trained, _ = ppo_with_statistics()
    trained.save(tmp_path / "model.zip")
    (tmp_path / "config.json").write_text(json.dumps({"options": SMALL}))
    with pytest.raises(FileNotFoundError, match="the agent is its file, .*model.zip"):
        agent.load_agent(str(tmp_path), make())
    with pytest.raises(FileNotFoundError, match='statistics.npz .*save_normalization .*{"normalise": {"observations": false}}'):
        agent.load_agent(str(tmp_path / "model.zip"), make())


def test_an_agent_of_which_nothing_says_how_it_sees_is_noted(tmp_path, trained):
    network, normalization = trained
    bare = write_agent(tmp_path / "bare", network, None)
    said = write_agent(tmp_path / "said", network, None, normalise={"observations": False})
    whole = write_agent(tmp_path / "whole", network, normalization)
    (line,) = caveats((str(folder), "TipPose", SMALL) for folder in (bare, said, whole))
    assert line.startswith(f"{bare}: there is no statistics.npz, and config.json does not say normalise.observations; ")
    both = caveats([("dagger", "TipPose", SMALL), ("dagger", "Reach", SMALL)])
    assert sum("judged without the" in line for line in both) == 2, "each task's agent was trained otherwise"


@pytest.fixture(scope="module")
def trained():
    model, statistics = ppo_with_statistics()
    return model.policy, normalization_of(statistics)


def pickled(path, bad):
    path.write_bytes(pickle.dumps(bad))


def with_torch(path, bad):
    torch.save({"action_net.weight": bad}, path)


def as_object_array(path, bad):
    with open(path, "wb") as file:
        np.savez(file, mean=np.array([bad], dtype=object), variance=np.ones(1), clip=np.float64(10.0), epsilon=np.float64(1e-8))


@pytest.mark.parametrize("write", [pickled, with_torch, as_object_array])
@pytest.mark.parametrize("name", ["weights.pt", "statistics.npz", "config.json"])
def test_what_is_pickled_in_an_agents_files_does_not_run(tmp_path, trained, malice, name, write):
    folder, ran = write_agent(tmp_path / "agent", *trained), tmp_path / "it_ran"
    agent.load_agent(str(folder), make())
    write(folder / name, malice(ran))
    with pytest.raises(ValueError, match=f"{folder / name}") as error:
        agent.load_agent(str(folder), make())
    assert not ran.exists() and len(str(error.value).splitlines()) == 1


def test_what_is_pickled_in_a_zip_file_does_not_run(tmp_path, malice):
    ran, bad = tmp_path / "it_ran", tmp_path / "bad.zip"
    PPO("MlpPolicy", make(), seed=0, device="cpu").save(tmp_path / "model.zip")
    encoded = base64.b64encode(pickle.dumps(malice(ran))).decode()
    for name in ("data", "policy.pth", "pytorch_variables.pth", "policy.optimizer.pth"):
        with zipfile.ZipFile(tmp_path / "model.zip") as old, zipfile.ZipFile(bad, "w") as new:
            for member in old.namelist():
                content = old.read(member)
                if member == name == "data":
                    table = json.loads(content)
                    tampered = {key: {**value, ":serialized:": encoded} for key, value in table.items() if isinstance(value, dict)}
                    content = json.dumps({**table, **tampered})
                elif member == name:
                    content = pickle.dumps(malice(ran))
                new.writestr(member, content)
        if name == "policy.pth":
            with pytest.raises(ValueError, match=f"{bad} holds no weights alone"):
                agent.load_agent(str(bad), make())
        else:
            agent.load_agent(str(bad), make())
        assert not ran.exists()


def test_a_policy_of_its_authors_own_classes_is_refused(tmp_path):
    class Own(FlattenExtractor):
        pass

    PPO("MlpPolicy", make(), policy_kwargs={"features_extractor_class": Own}, device="cpu").save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="policy_kwargs.features_extractor_class is <class .* cannot be known without running"):
        agent.load_agent(str(tmp_path / "model.zip"), make())


BIAS = "action_net.bias"


def weights(change):
    return lambda folder, network, normalization: torch.save(change(dict(network.state_dict())), folder / "weights.pt")


def arrays(**changes):
    def write(folder, network, normalization):
        moments = normalization.moments[""]
        values = {"mean": moments.mean, "variance": moments.variance, "clip": np.float64(10.0), "epsilon": np.float64(1e-8), **changes}
        np.savez(folder / "statistics.npz", **{key: value for key, value in values.items() if value is not None})

    return write


def table(**changes):
    def write(folder, network, normalization):
        path = folder / "config.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return write


@pytest.mark.parametrize(
    "spoil, said",
    [
        (weights(lambda found: {**found, BIAS: torch.nan * found[BIAS]}), "weights.pt: action_net.bias has weights that are not finite"),
        (
            weights(lambda found: found.pop(BIAS) is None or found),
            "weights.pt: the weights are not of a PPO policy for this env.*action_net",
        ),
        (weights(list), "weights.pt should hold tensors by name"),
        (arrays(mean=np.zeros(3), variance=np.ones(3)), r"statistics.npz is of observations \(3,\), this environment has"),
        (arrays(mean=None), "statistics.npz should have mean, variance, clip above 0 and epsilon, and nothing else .variance"),
        (arrays(clip=None), "statistics.npz should have mean, variance, clip and epsilon"),
        (arrays(clip=np.float64(np.nan)), "statistics.npz: clip is of type float64: it should be finite numbers"),
        (arrays(clip=np.float64(-1.0)), "statistics.npz should have mean, variance, clip above 0"),
        (arrays(variance=-np.ones(48)), "statistics.npz: variance should have variances of at least 0"),
        (arrays(more=np.ones(2)), "statistics.npz should have .* nothing else .more"),
        (table(algorithm="PPOO"), "config.json: algorithm is 'PPOO': it should be an algorithm: did you mean 'PPO'"),
        (table(algorithm=None), "does not say which algorithm it is of: name it ALGORITHM:"),
        (table(algorithm="SAC"), "weights.pt: the weights are not of a SAC policy"),
        (table(hyperparameters={"policy_kwargs": {"net_arch": [7]}}), "weights.pt: the weights are not of a PPO policy"),
        (table(hyperparameters={"policy_kwargs": {"net_archs": [7]}}), "policies of PPO have no argument net_archs"),
        (table(hyperparameters={"policy_kwargs": {"activation_fn": "os.system"}}), "activation_fn is 'os.system'"),
        (table(added_to="tracking"), "config.json: added_to is 'tracking': it is an unknown key, and should be taken out"),
        (table(hyperparameters={"policy_kwargs": 3}), "hyperparameters.policy_kwargs is 3: it should be a table"),
    ],
)
def test_an_agent_that_is_none_is_refused_in_one_line(tmp_path, trained, spoil, said):
    folder = write_agent(tmp_path / "agent", *trained)
    spoil(folder, *trained)
    with pytest.raises(ValueError, match=said) as error:
        agent.load_agent(str(folder), make())
    assert str(folder) in str(error.value) and len(str(error.value).splitlines()) == 1


def test_a_goal_reached_by_hindsight_needs_no_memory_of_it(tmp_path):
    """HER's buffer wants the environment, and a million samples of it."""
    SAC("MultiInputPolicy", make("Reach"), replay_buffer_class=HerReplayBuffer, device="cpu").save(tmp_path / "model.zip")
    env = make("Reach")
    action, _ = agent.load_agent(str(tmp_path / "model.zip"), env).predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "model.zip").write_text("not a zip")
    with pytest.raises(ValueError, match="is no agent of Stable-Baselines3"):
        agent.load_agent(str(tmp_path / "model.zip"), make())
    (tmp_path / "config.json").write_text("[]")
    with pytest.raises(ValueError, match="should be"):
        Agent(str(tmp_path / "model.zip"), "TipPose").options({})


@pytest.fixture
def ppo(tmp_path):
    """The file of an agent that has learned nothing, with its configuration beside it."""
    env = make(action="increment")
    PPO("MlpPolicy", env, n_steps=8, batch_size=4, seed=0, device="cpu").save(tmp_path / "model.zip")
    config = {"options": {**SMALL, "action": "increment"}, "layout": layout_of(env.unwrapped.episodes)}
    (tmp_path / "config.json").write_text(json.dumps(config))
    return str(tmp_path / "model.zip")


SWAPPED = ["rates", "coordinates", "tip_position", "tip_rotation", "tip_twist", "target_error", "target_twist", "preview", "last_action"]


@pytest.mark.cases(
    "task, options, said",
    [
        ("TipPose", {"observation": SWAPPED}, "was trained with the observation coordinates (6), rates (6), .* has rates (6)"),
        ("TipPose", {"preview": []}, "preview (12), last_action (3), this environment has .* preview (0)"),
        ("Shape", {}, "was trained with the observation .*target_coordinates (6)"),
        ("TipPose", {"scene": "paper"}, "was trained on an arm with other segments"),
        ("TipPose", {"scene": {"scene": "three_tendon", "segments[0].young_modulus": 1e5}}, "was trained on an arm with other segments"),
        ("TipPose", {"scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0, 0, -9.81]}}, "with other effects"),
    ],
)
def test_an_agent_is_refused_elsewhere(ppo, task, options, said):
    agent.load_agent(ppo, make(action="increment"))
    with pytest.raises(ValueError, match=said.replace("(", r"\(").replace(")", r"\)")):
        agent.load_agent(ppo, make(task, **{"action": "increment", **options}))


@pytest.mark.cases(
    "trained, judged, said",
    [
        ({"action": "increment"}, {}, None),
        ({"action": "increment", "control_period": 0.01}, {}, "trained with control_period = 0.01, judged with 0.02"),
        ({"action": "increment"}, {"control_period": 0.005}, "trained with control_period = 0.02, judged with 0.005"),
        ({"action": "increment", "observation": ["target_error"]}, {"fidelity": "standard"}, "trained with fidelity = 'fast', judged with"),
        ({"action": "increment"}, {"scene": load_scene("three_tendon")}, None),  # the same in other words
        ({"task": "Shape", "action": "increment"}, {}, "trained with task = 'Shape', judged with 'TipPose'"),
    ],
)
def test_an_agent_says_once_it_is_loaded_that_it_was_trained_otherwise(tmp_path, trained, judged, said):
    looks = {key: value for key, value in trained.items() if key == "observation"}
    PPO("MlpPolicy", make(action="increment", **looks), n_steps=8, batch_size=4, seed=0, device="cpu").save(tmp_path / "model.zip")
    task = {"task": trained.pop("task")} if "task" in trained else {}
    (tmp_path / "config.json").write_text(json.dumps({**task, "options": {**SMALL, **trained, "preview": [0.1, 0.2]}}))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", TrainingWarning)
        load_policy(str(tmp_path / "model.zip"), make(**{"action": "increment", "preview": [0.1, 0.2], **looks, **judged}))
    texts = [str(warning.message) for warning in found if warning.category is TrainingWarning]
    assert len(texts) == (said is not None) and all(f"{said}" in text and "policy_options()" in text for text in texts)


def test_rows_of_stable_baselines_are_an_environment_too(tmp_path, trained):
    envs = make_sb3_vec_env(IDS["TipPose"], 2, **SMALL)
    assert agent.load_agent(str(write_agent(tmp_path / "agent", *trained)), envs).predict(envs.reset())[0].shape == (2, 3)


@pytest.mark.cases("env", [lambda: gym.make("CartPole-v1"), lambda: None])
def test_environments_of_other_packages_are_refused(env):
    with pytest.raises(TypeError, match="env should be an environment of soft_tendon_env, not"):
        agent.load_agent("agent", env())


@pytest.mark.cases(
    "changes",
    [
        {"algorithm": "FadingPPO"},
        {"options": {"target": "spiral"}},
        {"options": {"scene": {"scene": "three_tendon", "effects.magnet.strength": 1.0}}},
    ],
)
def test_what_a_module_of_ones_own_registers_is_asked_for(tmp_path, trained, changes):
    folder = write_agent(
        tmp_path / str(len([*tmp_path.iterdir()])), *trained, **{**changes, "options": {**SMALL, **changes.get("options", {})}}
    )
    for use in (lambda: load_policy(str(folder), make()), lambda: Agent(str(folder), "TipPose").options({})):
        with pytest.raises(ConfigurationError, match="config.json: .*if a module of your own registers it, --import MODULE is missing"):
            use()


def test_an_agent_takes_along_its_arm_and_its_interface_but_not_what_it_learned(tmp_path):
    learned = {"target": "circle", "reward": {"position": 1.0}, "randomize": {"payload": 0.1}, "threshold": 0.02}
    kept = {**SMALL, "action": "increment", "preview": [0.1], "control_period": 0.01, "tension_limits": [0.0, 9.0]}
    (tmp_path / "model.zip").touch()
    (tmp_path / "config.json").write_text(json.dumps({"options": {**learned, **kept}}))
    assert Agent(str(tmp_path / "model.zip"), "TipPose").options({}) == kept


def test_an_agent_acts_whatever_its_training_drew(tmp_path, trained):
    """Short names of ranges, and the number of motions that its targets came from."""
    ranges = {"stiffness": [0.8, 1.2], "payload": [0.0, 0.02], "latency": [0.0, 0.02], "noise": {"position": 0.001}}
    target, env, seen = {"type": "random", "fraction": 0.4, "period": 4.8}, make(), np.linspace(-1.0, 1.0, 54)
    plain = write_agent(tmp_path / "plain", *trained)
    drawn = write_agent(tmp_path / "drawn", *trained, options={**SMALL, "target": {**target, "bank": 256}, "randomize": ranges})
    assert read_config(find_agent(str(drawn), "TipPose")).options["target"] == target
    assert policy_options(str(drawn), "TipPose", {}) == SMALL
    actions = [load_policy(str(folder), env).predict(seen)[0] for folder in (plain, drawn)]
    np.testing.assert_array_equal(*actions)
