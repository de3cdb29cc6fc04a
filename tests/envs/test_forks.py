"""Environments whose threads run, in forked processes, in copies, and beside workers that are forked: each goes on as if it were alone.

That a child and its parent both go on is a hard case, tests/hard_cases/test_processes.py.
"""

import copy
import os
import pickle
import signal
import threading

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS, TipPoseVectorEnv

ID = IDS["TipPose"]
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
ROWS = 24
SECONDS = 60  # after which a child that hangs is killed

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")


def forked(act):
    """What act() returns in a forked child."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(SECONDS)
            with os.fdopen(send, "wb") as file:
                file.write(pickle.dumps(act()))
            os._exit(0)
        finally:
            os._exit(1)
    os.close(send)
    with os.fdopen(receive, "rb") as file:
        result = file.read()
    status = os.waitpid(child, 0)[1]
    assert status == 0, "the child hangs" if os.WIFSIGNALED(status) else "the child fails"
    return pickle.loads(result)


def actions(seed, steps=4):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, ROWS, 3))


def stepped(env, seed, steps=4):
    """What some steps give, rejected steps and everything else that info says included."""
    return [env.step(action) for action in actions(seed, steps)]


@pytest.fixture
def env():
    """An environment in mid-episode, on three threads that run."""
    env = TipPoseVectorEnv(ROWS, threads=3, **SMALL)
    env.reset(seed=0)
    stepped(env, 1)
    assert sum(thread.name.startswith("ThreadPoolExecutor") for thread in threading.enumerate()) >= 2
    yield env
    env.close()


@pytest.fixture
def expected():
    """expected(seed): what the next steps of `env` give where nothing is forked."""

    def steps(*seeds):
        env = TipPoseVectorEnv(ROWS, threads=1, **SMALL)
        env.reset(seed=0)
        stepped(env, 1)
        return [stepped(env, seed) for seed in seeds][-1]

    return steps


def test_the_child_of_a_child(env, expected, same):
    def act():
        stepped(env, 2)
        return forked(lambda: stepped(env, 3)), stepped(env, 3)

    inner, outer = forked(act)
    assert same(inner, outer) and same(inner, expected(2, 3))


def test_a_child_has_threads_of_its_own_and_closes_them(env, expected, same):
    def step_and_close():
        before = threading.active_count()
        stepped(env, 2)
        meanwhile = threading.active_count()
        env.close()
        return before, meanwhile, threading.active_count()

    forked(env.close)
    assert forked(step_and_close) == (1, 3, 1)
    assert same(stepped(env, 3), expected(3))


def test_a_child_that_ends_as_python_does(env, expected, same):
    """With its handlers of the end, which wait for threads."""
    child = os.fork()
    if child == 0:
        signal.alarm(SECONDS)
        try:
            stepped(env, 2)
            threading._shutdown()
        finally:
            os._exit(0 if threading.active_count() == 1 else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert same(stepped(env, 3), expected(3))


def test_forked_by_a_thread(env, expected, same):
    results = []
    thread = threading.Thread(target=lambda: results.append(forked(lambda: stepped(env, 2))))
    thread.start()
    thread.join()
    assert same(results, [expected(2)]) and same(stepped(env, 2), expected(2))


def test_forked_while_another_thread_steps(env, same):
    """The child's rows are where the steps of its parent had come to; reset, it is like any other."""
    alone = TipPoseVectorEnv(ROWS, threads=1, **SMALL)
    begun = alone.reset(seed=5), *stepped(alone, 6)
    going = threading.Event()
    lived = []

    def steps():
        lived.append(env.reset(seed=7))
        while not going.is_set():
            lived.append(env.step(actions(len(lived), 1)[0]))

    thread = threading.Thread(target=steps)
    thread.start()
    try:
        for _ in range(10):
            assert same(forked(lambda: (env.reset(seed=5), *stepped(env, 6))), begun)
    finally:
        going.set()
        thread.join()
    assert same(lived, [alone.reset(seed=7), *(alone.step(actions(i, 1)[0]) for i in range(1, len(lived)))])


def test_forked_while_the_pool_is_locked(env, expected, same):
    """By a thread that hands it work, or stops it."""
    _, pool = env.episodes.arms._pool
    with pool._shutdown_lock:
        assert same(forked(lambda: (stepped(env, 2), env.close())[0]), expected(2))
        forked(env.close)
    assert same(stepped(env, 2), expected(2))


def test_workers_of_torch(env, expected, same):
    """A data loader whose workers step the environment that it was given."""
    data = pytest.importorskip("torch.utils.data")

    class Steps(data.IterableDataset):
        def __iter__(self):
            return iter([np.stack([result[1] for result in stepped(env, 2)])])

    loader = data.DataLoader(Steps(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=SECONDS, collate_fn=list)
    rewards = [result[1] for result in expected(2)]
    assert all(same([np.asarray(reward) for reward in batch], rewards) for batch in loader) and len(list(loader)) == 2
    assert same(stepped(env, 2), expected(2))


def test_forked_workers_of_gymnasium(env, expected, same):
    """Beside an environment whose threads run."""
    workers = gym.vector.AsyncVectorEnv([lambda: gym.make(ID, **SMALL)] * 2, context="fork")
    try:
        workers.reset_async(seed=3)
        found = [workers.reset_wait(timeout=SECONDS)[0]]
        for action in actions(2):
            workers.step_async(action[:2])
            found.append(workers.step_wait(timeout=SECONDS)[:4])
    finally:
        workers.close(terminate=True)
    alone = TipPoseVectorEnv(2, threads=1, **SMALL)
    assert same(found, [alone.reset(seed=3)[0], *(alone.step(action[:2])[:4] for action in actions(2))])
    assert same(stepped(env, 2), expected(2))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda arms: pickle.loads(pickle.dumps(arms))], ids=["deepcopy", "pickle"])
def test_copies_of_arms_go_on_by_themselves(env, copied):
    arms, twin = env.episodes.arms, copied(env.episodes.arms)
    tension = np.random.default_rng(0).uniform(0.0, 5.0, (ROWS, arms.substeps, 3))
    twin.step(tension, np.arange(ROWS))
    assert (twin.rows.q != arms.rows.q).any()
    arms.step(tension, np.arange(ROWS))
    for one, other in zip((*arms.outcome, *arms.reading), (*twin.outcome, *twin.reading), strict=True):
        np.testing.assert_array_equal(one, other)
    for name, values in arms.rows.fields().items():
        assert name == "arm" or np.array_equal(values, twin.rows.fields()[name])
    twin.close()
    arms.step(tension, np.arange(ROWS))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"])
def test_copies_of_environments_begin_anew(same, copied):
    """As Gymnasium's do: they are made of the same options."""
    env = TipPoseVectorEnv(ROWS, 3, "same_step", **SMALL)
    twin = copied(env)
    assert same(twin.reset(seed=4), env.reset(seed=4))
    for action in actions(2):
        step, expected = twin.step(action), env.step(action)
        assert same(step[:4], expected[:4]) and step[4].keys() == expected[4].keys()
