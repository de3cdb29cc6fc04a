"""Imitation: the teacher knows each arm as it is, the agent comes to act as the teacher would, and
the training goes on from there."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning import imitation, train
from soft_tendon_env.learning.vec_env import unwrapped

ARM = {"scene": "three_tendon", "fidelity": "fast"}
DRAWN = {
    "stiffness": [0.7, 1.3],
    "damping": [0.7, 1.5],
    "tension_gain": [0.8, 1.2],
    "latency": [0.0, 0.05],
    "payload": [0.0, 0.005],
}
SMALL = {"rounds": 2, "n_epochs": 2, "batch_size": 16}


@pytest.fixture
def lessons(training):
    """lessons(steps=..., ...): a small training with a teacher, changed."""
    return lambda **changes: training(
        **{"algorithm": "DAgger", "learning_rate": 1e-3, "hyperparameters": SMALL, **changes}
    )


def errors_of_the_teacher(task, steps=120, **options):
    """Errors (steps, rows) where the teacher itself acts on arms that all differ."""
    envs = gym.make_vec(
        IDS[task],
        num_envs=4,
        max_episode_steps=60,
        autoreset_mode="same_step",
        **{**ARM, **options},
    )
    envs.reset(seed=0)
    episodes = envs.unwrapped.episodes
    errors = []
    teacher = imitation.Teacher(episodes, 0.2)
    for _ in range(steps):
        actions = teacher.actions()
        assert actions.shape == (4, 3)
        assert (np.abs(actions) <= 1.0).all()
        envs.step(actions)
        error = next(iter(episodes.errors.values())).copy()
        errors.append(error)
    return np.array(errors) / episodes.model.length


@pytest.mark.slow
@pytest.mark.parametrize("task", ["TipPose", "Shape", "Reach"])
@pytest.mark.parametrize(
    "action",
    [{"action": "tension"}, {"action": "increment", "tension_rate": 50.0}],
    ids=["tension", "increment"],
)
def test_teacher_tracks_on_every_arm_as_drawn(task, action):
    slow = (
        {} if task == "Reach" else {"target": {"type": "random", "knot_period": 2.0}}
    )  # the law for shapes lags behind
    errors = errors_of_the_teacher(task, **action, **slow, randomize=DRAWN)
    squares = errors[-25:-1] ** 2
    rms = np.sqrt(np.mean(squares, axis=0))
    assert (rms < 0.02).all(), "in the second episode too, on other arms"


@pytest.mark.slow
def test_teacher_makes_up_for_the_delay_that_was_drawn(monkeypatch):
    late = {"latency": 0.06}
    aware = errors_of_the_teacher("TipPose", 60, randomize=late)[-25:-1].max()
    arriving = imitation.Teacher._predict_arrival
    monkeypatch.setattr(
        imitation.Teacher,
        "_predict_arrival",
        lambda self, sent, late: arriving(self, sent, 0.0 * late),
    )
    assert errors_of_the_teacher("TipPose", 60, randomize=late)[-25:-1].max() > 3.0 * aware


def test_teacher_needs_tensions_that_act_and_targets_that_are_known(lessons):
    elastic = {"effects.tendon_elasticity": {"stiffness": 1e4, "displacement_limits": [0.0, 0.05]}}
    for effect in ({"effects.actuators.time_constant": 0.05}, elastic):
        scene = {"scene": "three_tendon", **effect}
        env = train.make_training_env(lessons(options={**ARM, "scene": scene}))
        with pytest.raises(ValueError, match="a teacher needs commands that are tensions"):
            imitation.Teacher(unwrapped(env).env.episodes, 0.2)
    env = train.make_training_env(
        lessons(options={**ARM, "preview": [0.04], "randomize": {"latency": 0.03}})
    )
    env.reset()
    with pytest.raises(ValueError, match="the longest preview, 2 control periods, not for 4"):
        imitation.Teacher(unwrapped(env).env.episodes, 0.2).actions()


@pytest.mark.slow
@pytest.mark.parametrize("task", ["TipPose", "Shape", "Reach"])
def test_agent_comes_to_track_as_its_teacher_does(lessons, tmp_path, task):
    chosen = lessons(
        task=task,
        steps=1200,
        arms=8,
        seconds=1.2,
        options={**ARM, "action": "tension"},
        evaluation={"episodes": 6, "skip": 0.6},
        hyperparameters={**SMALL, "rounds": 3, "n_epochs": 40},
    )
    errors = []
    train.train(
        chosen,
        tmp_path,
        watch=lambda row: errors.append(next(row[name] for name in row if name.endswith("_rms"))),
    )
    assert errors[-1] < 0.4 * errors[0]


def test_environments_of_others_are_refused():
    with pytest.raises(
        TypeError, match="env is a DummyVecEnv: it should be made by make_sb3_vec_env"
    ):
        imitation.DAgger("MlpPolicy", gym.make(IDS["TipPose"], **ARM))
