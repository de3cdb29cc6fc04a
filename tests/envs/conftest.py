"""Arms that the environments are tried on, few since each kind compiles anew; episodes as lived, and their comparison bit for bit; a
controller that remembers what it is told."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import Decision
from soft_tendon_env.envs.policy import ControllerPolicy, interface_of

STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
ARMS = {
    "three_tendon": {"scene": "three_tendon", "fidelity": "fast"},
    "loaded": {
        "scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005},
        "fidelity": "fast",
    },
    "explicit": {
        "scene": {
            "scene": "three_tendon",
            "quadrature.intervals": 4,
            "strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}]},
        }
    },
}
EVERYTHING = {
    "stiffness": [0.8, 1.2],
    "damping": [0.5, 1.5],
    "density": [0.8, 1.2],
    "payload": [0.0, 0.01],
    "tension_gain": [0.9, 1.1],
    "tension_offset": [-0.1, 0.1],
    "latency": [0.0, 0.05],
    "noise": {"position": 0.001, "rotation": 0.01, "length": 0.001, "curvature": 0.1, "stretch": 0.01, "stretch_rate": 0.1},
}


@pytest.fixture(scope="session")
def arms():
    """Options by name: a plain arm, one with gravity and a payload, one with an explicit strain."""
    return ARMS


@pytest.fixture(params=ARMS)
def arm(request):
    """The options of each of them."""
    return ARMS[request.param]


@pytest.fixture(scope="session")
def everything():
    """Every randomisation at once."""
    return EVERYTHING


def _same(a, b):
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, np.ndarray) and a.dtype != object:
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and bool(np.all(a == b))


@pytest.fixture(scope="session")
def same():
    """same(a, b): whether nested values are alike bit for bit."""
    return _same


@pytest.fixture(scope="session")
def live():
    """live(env, seed, steps, actions=None): what reset and every step gave, with a reset whenever an episode ends.

    actions (steps, n_a); random ones that depend on the seed alone by default.
    """

    def lived(env, seed, steps, actions=None):
        if actions is None:
            actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *env.action_space.shape))
        history = [env.reset(seed=seed)]
        for action in actions:
            history.append(env.step(action))
            if history[-1][2] or history[-1][3]:
                history.append(env.reset())
        return history

    return lived


class Probe:
    """A controller that keeps the situations and memories it is given, asks for tensions that depend on all of them, and counts."""

    def __init__(self, tendons, least, span):
        self.weights, self.least, self.span, self.seen = np.arange(1.0, tendons + 1), least, span, []

    def act(self, now, memory=None):
        self.seen.append((now, memory))
        told = (now.q, now.q_dot, now.tip_pose, now.tension, now.target.tip_pose, now.target.tip_position, now.target.q)
        phase = (memory or 0) + sum(values.sum() for values in told if values is not None)
        return Decision(self.least + 0.5 * self.span * (1.0 + np.sin(self.weights * phase)), (memory or 0) + 1)


@pytest.fixture(scope="session")
def probed():
    """probed(env): a policy for three tendons and the probe it asks, for tensions from `least` [N] over `span` [N]."""

    def make(env, least=0.5, span=3.0):
        probe = Probe(3, least, span)
        return ControllerPolicy(probe, interface_of(env)), probe

    return make


@pytest.fixture(scope="session")
def short():
    """short(kind, id, **options): episodes of six steps, in a "single" environment or three rows of Gymnasium ("vector") or "sb3"."""

    def make(kind, id, **options):
        options = {"max_episode_steps": 6, "scene": "three_tendon", "fidelity": "fast", "preview": (0.02, 0.04, 0.1), **options}
        if kind == "single":
            return gym.make(id, **options)
        if kind == "vector":
            return gym.make_vec(id, num_envs=3, **options)
        from soft_tendon_env.envs.stable_baselines import make_sb3_vec_env  # loads torch, which few tests need

        return make_sb3_vec_env(id, 3, **options)

    return make


@pytest.fixture(scope="session")
def begun():
    """begun(env): the first observation, of seed 0."""

    def begin(env):
        if isinstance(env, gym.Env | gym.vector.VectorEnv):
            return env.reset(seed=0)[0]
        env.seed(0)
        return env.reset()

    return begin
