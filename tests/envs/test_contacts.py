"""Arms among obstacles: starts and targets are outside of them."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, State
from soft_tendon_env.envs import ReachEnv, ShapeEnv
from soft_tendon_env.model.contact_forces import contact_forces

BALL = {"type": "sphere", "position": [0.2, 0.0, 0.08], "radius": 0.04}


INSIDE = {
    "a ball in its middle": {"type": "sphere", "position": [0.02, 0.0, 0.0], "radius": 0.03},
    "a plate across": {"type": "box", "position": [0.15, 0.0, 0.0], "size": [0.02, 1.0, 1.0]},
    "below the ground": {"type": "plane", "position": [0.0, 0.0, 0.1]},
}


@pytest.mark.parametrize(
    "how",
    [
        "a plate across",
        # these search longest for a start
        *(
            pytest.param(how, marks=pytest.mark.slow)
            for how in ("a ball in its middle", "below the ground")
        ),
    ],
)
def test_an_arm_that_would_begin_inside_of_an_obstacle_is_refused(how):
    with pytest.raises(ConfigurationError) as error:
        ReachEnv(
            scene={"scene": "three_tendon", "effects.contact.obstacles": [BALL, INSIDE[how]]},
            fidelity="fast",
        )
    assert "scene has an arm that cannot begin at rest" in str(error.value)
    assert f"obstacles[1], a {INSIDE[how]['type']}" in str(error.value)
    assert "\n" not in str(error.value)


def test_drawn_motions_keep_the_whole_arm_clear_of_obstacles():
    """Shapes that the arm holds without touching anything, near as some of them come; obstacles
    that move are no hindrance."""
    env = ShapeEnv(
        scene="paper_among_obstacles", fidelity="fast", target={"type": "random", "fraction": 0.5}
    )
    free = env.episodes.starts.setting.free
    nearest = np.inf
    for seed in range(5):
        env.reset(seed=seed)
        q, _ = env.episodes.trajectories._course[0].coordinates(
            np.linspace(0.0, 10.0, 40, endpoint=False)
        )
        for each in q:
            model = env.model
            state = State(
                0.0,
                each,
                0.0 * each,
                model.grid.unpacked(model.packed_strain(each)),
                0.0,
                model.arm.effects.state,
            )
            nearest = min(nearest, contact_forces(model, state).clearance.min())
        assert free.holds(q).all()
    assert 0.0 < nearest < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("id", "scene"),
    [("TendonRod-Reach-v0", "paper_among_obstacles"), ("TendonRod-TipPose-v0", "underwater")],
)
def test_the_scenes_that_ship_are_lived_in(id, scene):
    """32 rows of random actions; targets that the arm can hold, outside of what is in its way."""
    envs = gym.make_vec(
        id, num_envs=32, scene=scene, fidelity="fast", action="tension", max_episode_steps=60
    )
    observation, info = envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(75):
        observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(observation)
        assert np.isfinite(reward).all()
        assert not terminated.any()
    episodes = envs.unwrapped.episodes
    if scene == "paper_among_obstacles":
        contact = episodes.model.scene.effects.contact
        found = [contact_forces(episodes.model, episodes.state(row)) for row in range(32)]
        assert any(forces.sample_force.any() for forces in found)
        assert max(forces.penetration.max() for forces in found) < 0.01
        assert (
            contact.distances(np.ascontiguousarray(episodes.target_pose[:, :3, 3])).min()
            > 0.9 * 0.02
        )
    envs.close()
