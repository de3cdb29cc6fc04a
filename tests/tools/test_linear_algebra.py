"""Threads of linear algebra: one within the context, as many as before after it."""

import threading

import gymnasium as gym
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from soft_tendon_env.control import ControllerOutput
from soft_tendon_env.envs import IDS
from soft_tendon_env.policies.controller_policy import ControllerPolicy
from soft_tendon_env.policies.network import MOST_ROWS, PolicyNetwork
from soft_tendon_env.tools import linear_algebra
from soft_tendon_env.tools.linear_algebra import one_thread


def counts():
    """Numbers of threads of the libraries of linear algebra."""
    return {entry["num_threads"] for entry in threadpool_info() if entry["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    linear_algebra._libraries.cache_clear()  # other tests may have loaded some since
    with threadpool_limits(2, user_api="blas"):
        if counts() != {2}:
            pytest.skip("this machine's linear algebra has one thread")
        yield


@pytest.mark.usefixtures("two_threads")
def test_products_have_one_thread_within_and_as_many_as_before_after_it():
    with one_thread():
        assert counts() == {1}
        with one_thread():
            assert counts() == {1}
        assert counts() == {1}
    assert counts() == {2}
    with pytest.raises(ArithmeticError), one_thread():
        raise ArithmeticError
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_another_thread_neither_waits_nor_restores_what_the_first_has_set():
    seen = []

    def use():
        with one_thread():
            seen.append(counts())

    other = threading.Thread(target=use)
    with one_thread():
        other.start()
        other.join()
        assert seen == [{1}]
        assert counts() == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize(("rows", "threads"), [(1, 2), (2, 1), (MOST_ROWS, 1), (MOST_ROWS + 1, 2)])
def test_policy_networks_act_on_a_few_rows_with_one_thread(rows, threads):
    box = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    seen = []

    class Actor:
        gates = None
        squashes = False

        def __call__(self, plain, memory):
            seen.append(counts())
            return plain, memory

    network = PolicyNetwork(Actor(), box, box)
    observations = np.tile(np.array([0.5, 2.0, -3.0], np.float32), (rows, 1))
    actions, _ = network.predict(observations)
    expected_actions = np.clip(observations, -1.0, 1.0)
    np.testing.assert_array_equal(actions, expected_actions)
    assert seen == [{threads}]
    assert counts() == {2}


class Counter:
    """A controller that asks for no tensions, and looks at the threads."""

    def __init__(self):
        self.seen = set()

    def act(self, now, memory=None):
        self.seen |= counts()
        return ControllerOutput(np.zeros(3), memory)


@pytest.mark.usefixtures("two_threads")
def test_a_controller_decides_with_one_thread():
    env = gym.make(IDS["Reach"], scene="three_tendon", fidelity="fast", action="tension")
    controller = Counter()
    policy = ControllerPolicy(controller, env)
    observation, _ = env.reset(seed=0)
    policy.predict(observation)
    assert controller.seen == {1}
    assert counts() == {2}
