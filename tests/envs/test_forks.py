"""Environments whose threads run, in forked processes and in copies: each goes on as if it were alone, bit for bit."""

import threading
from multiprocessing import get_context

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
ROWS = 24

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")


def forked(act):
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


def stepped(env, seed, steps=4):
    """What some steps give, rejected steps and everything else that info says included."""
    return [env.step(action) for action in np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, ROWS, 3))]


@pytest.fixture
def env():
    """An environment in mid-episode, on three threads that run."""
    env = TipPoseVectorEnv(ROWS, threads=3, **SMALL)
    env.reset(seed=0)
    stepped(env, 1)
    assert sum(thread.name.startswith("ThreadPoolExecutor") for thread in threading.enumerate()) >= 2
    yield env
    env.close()


def test_a_forked_child_and_its_parent_go_on_alike(env, same):
    """The child has threads of its own and closes them; its parent's may be handed work, or be stopped, when it is forked."""

    def act():
        before = threading.active_count()
        result = stepped(env, 2)
        meanwhile = threading.active_count()
        env.close()
        return result, (before, meanwhile, threading.active_count())

    _, pool = env.episodes.arms._pool
    with pool._shutdown_lock:
        child, threads = forked(act)
    assert same(child, stepped(env, 2)) and threads == (1, 3, 1)
