"""Copies, pickles and forks of environments go on from where these are, bit for bit, with
everything hidden, and by themselves."""

import copy
import pickle
import threading
from multiprocessing import get_context

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS, ReachVectorEnv, ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
MEMORY = {
    "scene": "three_tendon",
    "effects.tendon_friction.coefficient": 0.15,
    "effects.actuators": {"time_constant": 0.02, "delay": 0.017},
    "effects.viscoelastic_memory.branches": [{"modulus": 0.2, "relaxation_time": 0.2}],
    "effects.gravity.acceleration": [0.0, -9.81, 0.0],
}
BALL = {"type": "sphere", "radius": 0.02, "position": [0.15, 0.06, 0.0]}
AMONG = {"scene": "three_tendon", "effects.contact": {"obstacles": [BALL]}}
DRAWN = {
    "randomize": {
        "effects": {"gravity.acceleration": {"factor": [0.5, 1.0]}},
        "latency": [0.0, 0.07],
        "noise": {"length": 1e-3},
    }
}
KINDS = {
    "plain": SMALL,
    "memory": {
        **SMALL,
        "scene": MEMORY,
        **DRAWN,
        "history": 2,
        "observation": "measurable",
        "sensors": 2,
    },
    "increments": {
        **SMALL,
        "action": "increment",
        "tension_limits": [1.0, 12.0],
        "target": "steps",
    },
    "obstacles": {**SMALL, "scene": AMONG, "observation": ["coordinates", "target_error"]},
    "held": {
        **SMALL,
        "scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]},
        "target": "hold",
    },
    "spline": {
        **SMALL,
        "scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]},
        "sensors": [0.1],
    },
}
COPIES = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
}
ROWS = 24


def play(env, seed, steps, reset=True):
    """What steps with random actions give, and after them a reset and another step."""
    rng = np.random.default_rng(seed)
    actions = rng.uniform(-1.2, 1.2, (steps, *env.action_space.shape))
    found = [env.step(action) for action in actions]
    return (
        [*found, env.reset(), env.step(actions[0]), env.action_space.sample()] if reset else found
    )


@pytest.mark.parametrize("kind", KINDS)
def test_copies_of_one_environment_go_on_alike_and_by_themselves(kind, same):
    """With Gymnasium's wrappers around, which count steps. Neither is changed by what the other
    does."""
    task = "Shape" if kind == "spline" else "TipPose"
    env = gym.make(IDS[task], max_episode_steps=30, **KINDS[kind])
    env.reset(seed=6)
    env.action_space.seed(1)
    play(env, 0, 11, reset=False)
    copies = [make(env) for make in COPIES.values()]
    first = play(copies[0], 1, 19)  # which ends an episode, for it alone
    assert first[18][3]
    assert not first[17][3]
    expected = play(env, 1, 19)
    assert all(
        same(expected, found) for found in (first, *(play(other, 1, 19) for other in copies[1:]))
    )


@pytest.mark.parametrize(
    ("made", "kind", "mode"),
    [
        (ReachVectorEnv, "plain", "next_step"),
        (ReachVectorEnv, "plain", "same_step"),
        pytest.param(ShapeVectorEnv, "spline", "disabled", marks=pytest.mark.slow),
        pytest.param(TipPoseVectorEnv, "memory", "next_step", marks=pytest.mark.slow),
        pytest.param(TipPoseVectorEnv, "memory", "same_step", marks=pytest.mark.slow),
    ],
)
def test_copies_of_rows_go_on_alike_and_by_themselves(made, kind, mode, everything, same):
    """While rows that have ended wait for their reset."""
    options = {**KINDS[kind], "randomize": {**everything, **KINDS[kind].get("randomize", {})}}
    env = made(4, 12, mode, **options)
    env.reset(seed=2, options={"episode_steps": [7, None, 7, 9]})
    play(env, 0, 7, reset=False)
    copies = [make(env) for make in COPIES.values()]

    def lived(env):
        begun = (
            env.reset(options={"reset_mask": np.array([True, False, True, False])})
            if mode == "disabled"
            else None
        )
        return begun, *play(env, 1, 2), env.state[3].q, env.timed_out

    expected = lived(copies[0])
    assert all(same(expected, lived(other)) for other in (*copies[1:], env))
    env.close()
    assert not same(play(copies[0], 5, 1), play(copies[1], 6, 1))


def test_what_is_recorded_is_not_copied(tmp_path):
    pytest.importorskip("rerun")
    from soft_tendon_env.recording import RecordRollout

    env = RecordRollout(TipPoseEnv(**SMALL), tmp_path / "a.rrd")
    env.reset(seed=0)
    for copied in COPIES.values():
        with pytest.raises(
            TypeError, match="a.rrd cannot be copied: copy an environment without RecordRollout"
        ):
            copied(env)
    copy.deepcopy(env.unwrapped).step(np.zeros(3))
    env.close()


def run_in_a_fork(act):
    """What act() returns in a forked child."""
    context = get_context("fork")
    receive, send = context.Pipe(duplex=False)
    child = context.Process(target=lambda: send.send(act()))
    child.start()
    try:
        assert receive.poll(60.0), "the child hangs"
        return receive.recv()
    finally:
        child.kill()
        child.join()


def step_randomly(env, seed, steps=4):
    """What some steps give, rejected steps and everything else that info says included."""
    return [
        env.step(action)
        for action in np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, ROWS, 3))
    ]


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_forked_child_and_its_parent_go_on_alike(same):
    """The child has threads of its own and closes them; its parent's may be handed work, or be
    stopped, when it is forked."""
    env = TipPoseVectorEnv(ROWS, threads=3, scene="three_tendon", fidelity="fast")
    env.reset(seed=0)
    step_randomly(env, 1)
    assert (
        sum(thread.name.startswith("ThreadPoolExecutor") for thread in threading.enumerate()) >= 2
    )

    def act():
        before = threading.active_count()
        result = step_randomly(env, 2)
        meanwhile = threading.active_count()
        env.close()
        return result, (before, meanwhile, threading.active_count())

    _, pool = env.episodes.arms._pool
    with pool._shutdown_lock:
        child, threads = run_in_a_fork(act)
    assert same(child, step_randomly(env, 2))
    assert threads == (1, 3, 1)
    env.close()
