"""Signals let the tendons of every arm go, whichever was closed first, and come back in the end."""

import signal
import threading

import numpy as np
import pytest

from soft_tendon_env.robots import RobotEnv
from soft_tendon_env.robots.signals import (
    HARMLESS,
    HOLDERS,
    MACHINE_FAULTS,
    UNCATCHABLE,
    Holders,
    ending_signals,
    name_of,
)


class Held:
    """An arm that keeps the causes of its stops."""

    def __init__(self):
        self.causes = []
        self.is_letting_go = False

    def order_stop(self, cause):
        self.causes.append(cause)


@pytest.fixture
def holders():
    """Holders of their own, after those of arms that other tests may have left."""
    for arm in [*HOLDERS._arms]:
        HOLDERS.remove(arm)
    own = Holders()
    yield own
    for arm in [*own._arms]:
        own.remove(arm)


@pytest.mark.parametrize("number", ending_signals())
def test_every_signal_that_can_be_caught_lets_all_arms_go(number, holders):
    first = Held()
    second = Held()
    before = signal.getsignal(number)
    if before not in (signal.SIG_DFL, signal.default_int_handler):
        pytest.skip("Python ignores it, or somebody handles it")
    holders.add(first)
    holders.add(second)
    with pytest.raises(KeyboardInterrupt, match=f"interrupted by {name_of(number)}"):
        signal.raise_signal(number)
    assert first.causes == second.causes == [f"interrupted by {name_of(number)}"]
    holders.remove(first)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)
    assert [len(arm.causes) for arm in (first, second)] == [1, 2]
    holders.remove(second)
    assert signal.getsignal(number) == before


def test_signals_are_those_that_end_or_stop_a_process():
    names = {name_of(number) for number in ending_signals()}
    assert names >= {"SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGUSR2"}
    assert names >= {"SIGALRM", "SIGXCPU", "SIGABRT", "SIGVTALRM", "SIGPROF"}
    assert not names & {*UNCATCHABLE, *MACHINE_FAULTS, *HARMLESS}
    assert len(ending_signals()) >= len(signal.valid_signals()) - 12


def test_a_second_signal_does_not_interrupt_what_lets_go(holders):
    arm = Held()
    holders.add(arm)
    arm.is_letting_go = True
    signal.raise_signal(signal.SIGTERM)
    assert not arm.causes
    arm.is_letting_go = False
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)


def test_what_somebody_else_handles_is_theirs(holders):
    taken = []
    before = signal.signal(signal.SIGUSR1, lambda *arguments: taken.append(arguments))
    arm = Held()
    holders.add(arm)
    signal.raise_signal(signal.SIGUSR1)
    assert len(taken) == 1
    assert not arm.causes
    handler = signal.signal(signal.SIGUSR2, lambda *arguments: None)  # taken away meanwhile
    assert handler == holders._take
    own = signal.getsignal(signal.SIGUSR2)
    holders.remove(arm)
    assert signal.getsignal(signal.SIGUSR2) is own
    signal.signal(signal.SIGUSR1, before)
    signal.signal(signal.SIGUSR2, signal.SIG_DFL)


def test_signals_are_given_back_also_after_another_thread_has_closed_the_last_arm(holders):
    arm = Held()
    taken = []
    holders.add(arm)
    thread = threading.Thread(target=holders.remove, args=(arm,))
    thread.start()
    thread.join()
    holders._before[signal.SIGUSR1] = lambda *arguments: taken.append(arguments)
    signal.raise_signal(signal.SIGUSR1)  # as before it was taken
    assert len(taken) == 1
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    signal.signal(signal.SIGUSR1, signal.SIG_DFL)


def test_an_arm_of_another_thread_counts_without_its_signals(holders):
    arm = Held()
    thread = threading.Thread(target=holders.add, args=(arm,))
    thread.start()
    thread.join()
    assert holders._arms == [arm]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    holders.add(arm)  # by the main thread, which counts it no second time
    assert holders._arms == [arm]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    holders.forget()  # as in a forked process
    assert not holders._arms
    holders.remove(arm)


@pytest.mark.parametrize("closed", [0, 1])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGXCPU])
def test_of_two_robots_the_one_that_goes_on_is_let_go(
    closed, number, arm_of_test, drawing, wait_until
):
    arms = [arm_of_test(), arm_of_test()]
    envs = [RobotEnv(drawing(), arm, settle=0.0) for arm in arms]
    for env in envs:
        env.reset(seed=0)
        env.step(np.ones(3))
    envs[closed].close()
    pulled = arms[1 - closed]
    assert not pulled.is_slack
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)
    wait_until(lambda: pulled.is_slack)
    wait_until(lambda: not envs[1 - closed]._safe.is_letting_go)
    assert envs[1 - closed].stopped.cause == f"interrupted by {name_of(number)}"
    envs[1 - closed].close()
    assert signal.getsignal(number) is signal.SIG_DFL
