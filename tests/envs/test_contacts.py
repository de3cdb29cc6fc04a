"""Arms among obstacles: starts and targets are outside of them."""

import gymnasium as gym
import numpy as np
import pytest

import soft_tendon_env  # noqa: F401
from soft_tendon_env.envs import ReachEnv, ReachVectorEnv, ShapeEnv, TipPoseEnv
from soft_tendon_env.envs.targets import PoseCourse, Target, pose_samples
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.configuration import ConfigurationError

FLOOR = {"type": "plane", "position": [0.0, 0.0, -0.04]}
BALL = {"type": "sphere", "position": [0.2, 0.0, 0.08], "radius": 0.04}


def touching(obstacles=(FLOOR, BALL), **more):
    """Options of a small arm that its weight lays on a floor, below a ball."""
    scene = {
        "scene": "three_tendon",
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.contact": {"obstacles": list(obstacles), "friction": 0.4},
    }
    return {"scene": scene, "fidelity": "fast", **more}


INSIDE = {
    "a ball in its middle": {"type": "sphere", "position": [0.02, 0.0, 0.0], "radius": 0.03},
    "a plate across": {"type": "box", "position": [0.15, 0.0, 0.0], "size": [0.02, 1.0, 1.0]},
    "below the ground": {"type": "plane", "position": [0.0, 0.0, 0.1]},
}


@pytest.mark.parametrize("how", INSIDE)
def test_an_arm_that_would_begin_inside_of_an_obstacle_is_refused(how):
    with pytest.raises(ConfigurationError) as error:
        ReachEnv(scene={"scene": "three_tendon", "effects.contact.obstacles": [BALL, INSIDE[how]]}, fidelity="fast")
    assert "scene has an arm that cannot begin at rest" in str(error.value) and f"obstacles[1], a {INSIDE[how]['type']}" in str(error.value)
    assert "\n" not in str(error.value)


def posed(x, y, z):
    return [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    "target",
    [{"type": "hold", "pose": posed(0.2, 0.0, 0.07)}, {"type": "circle", "centre": [0.2, 0.0, 0.0], "radius": 0.1, "tilt": 0.0}],
)
def test_a_given_target_inside_of_an_obstacle_is_refused(target):
    with pytest.raises(ConfigurationError, match=r"target lies inside of an obstacle: the tip would be .* mm deep in effects\.c"):
        TipPoseEnv(**touching([BALL, {**FLOOR, "position": [0.0, 0.0, -0.08]}]), target=target)
    TipPoseEnv(**touching([{**BALL, "velocity": [0.0, 0.1, 0.0]}]), target={"type": "hold", "pose": posed(0.2, 0.0, 0.07)})


class Anywhere(Target):
    """Poses drawn in a cube in front of the arm, obstacles or not."""

    type: str = "anywhere"

    @property
    def is_random(self):
        return True

    def draw(self, generator, setting):
        place = [0.2, 0.0, 0.05] + generator.uniform(-0.06, 0.06, 3)
        return Fixed(posed(*place))


class Fixed(PoseCourse):
    def __init__(self, pose):
        self.pose = np.array(pose)

    def sample(self, times):
        return pose_samples(np.tile(self.pose, (times.size, 1, 1)), np.zeros((times.size, 6)))


def test_a_drawn_target_inside_of_an_obstacle_is_drawn_again():
    vector = ReachVectorEnv(16, **touching([BALL]), target=Anywhere())
    vector.reset(seed=0)
    away = np.linalg.norm(vector.episodes.target_pose[:, :3, 3] - BALL["position"], axis=1)
    assert away.min() > 0.04 + 0.009 and away.min() < 0.06
    vector.close()


def test_drawn_motions_keep_the_whole_arm_clear_of_obstacles():
    """Shapes that the arm holds without touching anything, near as some of them come; obstacles that move are no hindrance."""
    env = ShapeEnv(scene="paper_among_obstacles", fidelity="fast", target={"type": "random", "fraction": 0.5})
    free, nearest = env.episodes.starts.setting.free, np.inf
    for seed in range(5):
        env.reset(seed=seed)
        q, _ = env.episodes._courses._course[0].coordinates(np.linspace(0.0, 10.0, 40, endpoint=False))
        for each in q:
            model = env.model
            state = State(0.0, each, 0.0 * each, model.grid.unpacked(model.packed_strain(each)), 0.0, model.arm.effects.state)
            nearest = min(nearest, contact_forces(model, state).clearance.min())
        assert free.holds(q).all()
    assert 0.0 < nearest < 0.05


@pytest.mark.parametrize("id, scene", [("TendonRod-Reach-v0", "paper_among_obstacles"), ("TendonRod-TipPose-v0", "underwater")])
def test_the_scenes_that_ship_are_lived_in(id, scene):
    """64 rows of random actions; targets that the arm can hold, outside of what is in its way."""
    envs = gym.make_vec(id, num_envs=64, scene=scene, fidelity="fast", max_episode_steps=100)
    observation, info = envs.reset(seed=0)
    envs.action_space.seed(0)
    steps = 150
    for _ in range(steps):
        observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(observation) and np.isfinite(reward).all() and not terminated.any()
    episodes = envs.unwrapped.episodes
    if scene == "paper_among_obstacles":
        contact, found = episodes.model.scene.effects.contact, [contact_forces(episodes.model, episodes.state(row)) for row in range(64)]
        assert any(own.sample_force.any() for own in found) and max(own.penetration.max() for own in found) < 0.01
        assert contact.distances(np.ascontiguousarray(episodes.target_pose[:, :3, 3])).min() > 0.9 * 0.02
    envs.close()
