"""Deadlines are absolute: what is late makes nothing after it late; overruns are counted."""

import numpy as np
import pytest

from soft_tendon_env.robots.clock import Pacer, RealClock, SteppedClock


def test_a_late_period_does_not_move_the_next_deadlines():
    clock = SteppedClock()
    pacer = Pacer(clock, 0.02)
    begun = []
    for busy in (0.005, 0.05, 0.001, 0.001, 0.001):  # the second one takes two and a half periods
        clock.wait_until(clock.now() + busy)
        pacer.wait()
        begun.append(clock.now())
    np.testing.assert_allclose(begun, [0.02, 0.07, 0.071, 0.08, 0.1], atol=1e-12)
    timing = pacer.timing
    assert (timing.periods, timing.overruns) == (5, 2)
    assert timing.worst == pytest.approx(0.03) and timing.p50 == pytest.approx(0.0, abs=1e-12)


def test_real_time_is_waited_for():
    clock = RealClock()
    start = clock.now()
    pacer = Pacer(clock, 0.01)
    late = [pacer.wait() for _ in range(5)]
    assert clock.now() >= start + 0.05 and min(late) >= 0.0
