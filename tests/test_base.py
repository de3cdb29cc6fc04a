"""An arm whose base is elsewhere, in surroundings that move along, does all that it does at the
world's origin: rotated twins."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import (
    ConfigurationError,
    Simulation,
    load_scene,
    simulate,
    static_equilibrium,
    tension_for_tip_pose,
)
from soft_tendon_env.control import ExtendedKalmanFilter, Reference, Setting, controllers_of
from soft_tendon_env.control.protocol import ControllerInput, Measurement
from soft_tendon_env.model.model import model_on
from soft_tendon_env.policies.agent import load_agent
from soft_tendon_env.scene.scene import Base

BASE = Base(
    position=(0.3, -1.2, 0.7), quaternion=(0.6, -0.48, 0.6401, 0.0), rotation=(20.0, -35.0, 50.0)
)
VECTORS = ("acceleration", "force", "moment", "current", "velocity", "amplitude", "axis")
GRAVITY = {"effects.gravity.acceleration": [2.0, -3.0, -9.0]}
LOADS = {
    **GRAVITY,
    "effects.tip_load": {"force": [0.0, 0.03, 0.05], "moment": [0.002, 0.0, 0.003], "mass": 0.005},
}
SHAKEN = {
    "velocity": [0.1, 0.0, 0.2],
    "amplitude": [0.0, 0.02, 0.01],
    "frequency": 1.5,
    "axis": [1.0, 2.0, 0.0],
    "angular_velocity": 1.0,
}
BAR = {
    "type": "capsule",
    "position": [0.2, 0.03, 0.0],
    "radius": 0.01,
    "length": 0.2,
    "axis": [0.0, 0.2, 1.0],
    "velocity": [0, -0.02, 0],
}
FULL = {
    "type": "explicit",
    "modes": [{"strains": ["torsion", "bend_y", "bend_z", "stretch"], "order": 1, "span": "rod"}],
}
CASES = [
    {},
    LOADS,
    {**LOADS, "strain.include_loads": True},
    {**LOADS, "strain": FULL},
    {**GRAVITY, "effects.fluid": {"density": 1000.0, "current": [0.1, 0.2, -0.1]}},
    {**GRAVITY, "effects.contact": {"obstacles": [BAR], "friction": 0.3}},
    {"effects.moving_base": SHAKEN},
    {**GRAVITY, "effects.tendon_friction.coefficient": 0.2},
    {
        "effects.disturbance.loads": [
            {"at": 0.2, "force": [0.0, 0.1, 0.1], "moment": [0.01, 0.0, 0.0]}
        ]
    },
]


def moved(value, key=""):
    """Tables of effects in the frame of the base, as seen in the world."""
    if isinstance(value, dict):
        return {name: moved(entry, name) for name, entry in value.items()}
    if isinstance(value, tuple) and isinstance(value[0], dict):
        return [moved(entry) for entry in value]
    if key in (*VECTORS, "position"):
        turned = BASE.pose[:3, :3] @ value
    else:
        turned = value
    return (
        (turned + BASE.pose[:3, 3]).tolist()
        if key == "position"
        else turned.tolist()
        if key in VECTORS
        else value
    )


def twins(changes):
    """A scene with the base at the origin, and the same with base and surroundings elsewhere."""
    scene = load_scene("three_tendon").replace({"quadrature.intervals": 6, **changes})
    return scene, scene.replace(
        {"base": BASE.model_dump(), "effects": moved(scene.effects.model_dump(exclude_none=True))}
    )


def assert_moved(there, here):
    """Poses (..., 4, 4) are those at the origin, moved along with the base, to 1e-9 of the
    length."""
    expected = BASE.pose @ here
    np.testing.assert_allclose(there, expected, rtol=0.0, atol=3e-10)


@pytest.mark.parametrize("changes", CASES)
def test_equilibria_and_motions_move_along(changes):
    found = []
    for scene in twins(changes):
        model = model_on(scene, 6)
        rest = static_equilibrium(model, [2.0, 0.5, 0.0], settle=True)
        motion = simulate(model, [1.0, 3.0, 0.0], 0.2, 0.05)
        poses = np.concatenate(
            [rest.tip_pose[None], motion.tip_pose, model.backbone(motion.final.q, 7)]
        )
        found.append((rest.converged, rest.stable, poses))
    assert found[0][:2] == found[1][:2] == (True, True)
    assert_moved(found[1][2], found[0][2])


def test_inverse_statics_and_the_loss_of_stability_move_along():
    pressed = [model_on(scene, 6) for scene in twins({"effects.tip_load.force": [-3.0, 0.0, 0.0]})]
    assert [
        static_equilibrium(model, np.zeros(3), np.zeros(model.coordinate_count)).stable
        for model in pressed
    ] == [False, False]
    here, there = (model_on(scene, 6) for scene in twins(LOADS))
    pose = static_equilibrium(here, [2.0, 0.0, 1.0]).tip_pose
    found = [
        tension_for_tip_pose(model, wanted)
        for model, wanted in ((here, pose), (there, BASE.pose @ pose))
    ]
    assert found[0].reachable
    assert found[1].reachable
    np.testing.assert_allclose(found[1].tension, found[0].tension, atol=1e-6)


@pytest.mark.parametrize(
    ("task", "target"),
    [("TipPose", "circle"), ("TipPose", "out_of_reach"), ("TipPose", "random"), ("Reach", "hold")],
)
def test_targets_and_observations_move_along(task, target):
    found = []
    for scene in twins(LOADS):
        env = gym.make(f"TendonRod-{task}-v0", scene=scene, fidelity="scene", target=target)
        env.reset(seed=2)
        for _ in range(5):
            observation, *_ = env.step([0.2, -0.5, -1.0])
        found.append(episodes := env.unwrapped.episodes)
        assert env.observation_space.contains(observation)
        if task == "Reach":
            np.testing.assert_allclose(
                observation["desired_goal"], episodes.target_pose[0, :3, 3], atol=1e-6
            )
    here, there = found
    assert_moved(there.target_pose[0], here.target_pose[0])
    assert_moved(there.observed.tip_pose[0], here.observed.tip_pose[0])
    np.testing.assert_allclose([*there.errors.values()], [*here.errors.values()], atol=1e-9)


def test_model_predictive_control_behind_a_kalman_filter_does_not_know_where_the_base_is():
    errors = []
    pose = static_equilibrium(model_on(twins(LOADS)[0], 6), [2.0, 0.0, 1.0]).tip_pose
    for scene in twins(LOADS):
        model = model_on(scene, 6)
        last = None
        memory = None
        goal = Reference(np.zeros(1), (scene.base.pose @ pose)[None])
        controller = controllers_of("TipPose")["predictive"].make(
            model, np.tile([0.0, 5.0], (3, 1)), 0.02
        )
        observer = ExtendedKalmanFilter(model, Setting(0.02, np.zeros(3), ("tendon_length",)))
        arm = Simulation(model)
        sent = [np.zeros(3)] * observer.history
        arm.reset_at_rest()
        for k in range(12):
            lengths = model.tendon_lengths(arm.state.q)
            last = observer.estimate(
                Measurement(
                    arm.tip_pose,
                    np.array(sent[-observer.history :]),
                    0.02 * k,
                    tendon_length=lengths,
                ),
                last,
            )
            decision = controller.act(
                ControllerInput(*last[:3], sent[-1], goal, 0.02 * k, last.input_error), memory
            )
            memory = decision.memory
            sent = [*sent, decision.tension]
            arm.step(decision.tension, 0.02)
            error = np.linalg.norm(arm.tip_pose[:3, 3] - goal.tip_pose[0, :3, 3])
            errors.append(error)
    here, there = np.split(np.array(errors), 2)
    assert here[-1] < 0.5 * here[0]
    np.testing.assert_allclose(there, here, atol=1e-9)


def test_a_base_far_off_or_drawn_is_observed_where_it_is():
    drawn = {"base.position": [[-6.0, -5.0], 0.0, [8.0, 9.0]], "base.rotation": [[-5.0, 5.0]] * 3}
    env = gym.make(
        "TendonRod-TipPose-v0",
        scene="three_tendon",
        fidelity="fast",
        observation=["tip_position"],
        randomize=drawn,
    )
    places = {
        tuple(env.unwrapped.episodes.arms.model_of(0).scene.base.position)
        for seed in range(3)
        if env.reset(seed=seed)
    }
    observation, *_ = env.step(np.zeros(3))
    assert len(places) == 3
    assert env.observation_space.contains(observation)
    np.testing.assert_allclose(
        0.3 * observation, env.unwrapped.episodes.observed.tip_pose[0, :3, 3], atol=1e-5
    )
    with pytest.raises(
        ConfigurationError,
        match="base.quaternion is no parameter: its four numbers are one rotation: base.rotation",
    ):
        gym.make(
            "TendonRod-TipPose-v0",
            scene="three_tendon",
            randomize={"base.quaternion": [1.0, 0.0, 0.0, 0.0]},
        )
    with pytest.raises(ValueError, match="agent was trained on an arm with other base"):
        scene = load_scene("paper").replace({"base": BASE.model_dump()})
        load_agent("agent", gym.make("TendonRod-TipPose-v0", scene=scene))
