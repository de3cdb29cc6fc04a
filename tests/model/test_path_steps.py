"""Steps along a path of equilibria: how long they are, what is refused where the arm is soft, and
the flow of an arm that settles."""

import numpy as np
import pytest

from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import LoadPath, _flow

TENSION = np.array([2.0, 0.5, 1.0])  # [N]
STRAY = 0.1  # [rad] that the middle of a step may be off
CORRECTION = 0.5  # [rad] that an equilibrium may be off what is predicted
SOFT = 0.3  # of the unloaded arm's stiffness, below which both shrink with it
SOFTEST = 1e-2  # of them, what is left at least
SHORTEST = 2e-5  # of the load reached, the shortest step
LEAST_LOAD = 1e-7  # of the full load, likewise


@pytest.fixture
def path(bent):
    """The path of an arm with two curvatures under tensions and its weight."""
    with bent.workspace() as work:
        yield LoadPath(Balance(bent, TENSION, work))


@pytest.fixture
def begin(path):
    """The equilibrium under 0.4 of the load."""
    return path.equilibrium(np.zeros(2), 0.4)


@pytest.mark.parametrize("reached", [0.4, 1e-3])
def test_steps_that_fail_are_halved_to_the_shortest(path, monkeypatch, reached):
    """As a share of the load reached; then the last equilibrium is the end, and why is told. The
    first one moves the arm by an angle of 3 at most, to first order."""
    begin = path.equilibrium(np.zeros(2), reached)
    aims = []

    def fail(point, aim):
        assert len(aims) < 100
        aims.append(aim)
        path.balance.obstacle = "nothing goes on"

    monkeypatch.setattr(path, "step", fail)
    end, reason = path.follow(begin)
    steps = np.array(aims) - reached
    way = path.balance.angle(begin.tangent)
    assert (way > 3.0) == (reached < 0.1)
    first = min(1.0 - reached, 3.0 / way)
    shortest = max(reached * SHORTEST, LEAST_LOAD)
    expected = first * 0.5 ** np.arange(len(aims))
    np.testing.assert_allclose(steps, expected, rtol=1e-6)
    assert 0.5 * steps[-1] < shortest <= steps[-1]
    assert end is begin
    assert reason == f"beyond {100 * reached:g} % of the load: nothing goes on"


def test_steps_that_succeed_are_doubled(path, begin, monkeypatch):
    """And end at the full load."""
    parts = []

    def take(point, aim):
        parts.append((point.evaluation.part, aim))
        if aim - point.evaluation.part > 0.11:
            return None
        return path.equilibrium(point.evaluation.q, aim)

    monkeypatch.setattr(path, "step", take)
    end, reason = path.follow(begin)
    assert reason == ""
    assert end.evaluation.part == 1.0
    assert end.evaluation.residual <= 1e-10
    taken = [aim - part for part, aim in parts]
    # 0.6, 0.3, 0.15 fail; after a step of 0.075 twice as much does
    np.testing.assert_allclose(taken[:6], [0.6, 0.3, 0.15, 0.075, 0.15, 0.075], rtol=1e-9)


def test_paths_that_wind_too_much_are_given_up(path, begin, monkeypatch):
    short = LoadPath(path.balance, most=3)
    monkeypatch.setattr(short, "step", lambda *step: None)
    path.balance.linearisations = 3
    _, reason = short.follow(begin)
    assert "winding" not in reason
    path.balance.linearisations = 4
    end, reason = short.follow(begin)
    assert end is begin
    assert "the path is too winding, 3 iterations did not do" in reason


def soften(point, least):
    """A point whose stiffness is this part of that of the unloaded arm."""
    point.stability = point.stability._replace(least=least)
    return point


@pytest.mark.parametrize("is_ahead", [False, True], ids=["behind", "ahead"])
@pytest.mark.parametrize(
    ("least", "allowed"),
    [(1.0, STRAY), (0.1 * SOFT, 0.1 * STRAY), (1e-9, SOFTEST * STRAY)],
    ids=["stiff", "soft", "softest"],
)
def test_middles_of_steps_may_stray_less_where_the_arm_is_soft(
    path, begin, monkeypatch, is_ahead, least, allowed
):
    """In proportion to its stiffness at the softer end, down to a hundredth."""
    ahead = path.equilibrium(begin.evaluation.q, 0.5)
    soften(begin, 1.0 if is_ahead else least)
    soften(ahead, least if is_ahead else 1.0)

    def as_predicted(predicted, part):
        ahead.evaluation = ahead.evaluation._replace(q=predicted)
        return ahead

    monkeypatch.setattr(path, "equilibrium", as_predicted)
    for share, is_taken in ((0.95, True), (1.05, False)):
        monkeypatch.setattr(path, "_stray", lambda *middle, s=share: s * allowed)
        assert (path.step(begin, 0.5) is ahead) == is_taken


@pytest.mark.parametrize("least", [1.0, 0.1 * SOFT])
@pytest.mark.parametrize(("share", "is_taken"), [(0.95, True), (1.05, False)])
def test_newton_may_not_go_far_from_what_is_predicted(
    path, begin, monkeypatch, least, share, is_taken
):
    """By an angle to which the step's tangent leads it, less where the arm is soft."""
    ahead = path.equilibrium(begin.evaluation.q, 0.5)
    soften(begin, 1.0)
    soften(ahead, least)
    direction = np.array([0.6, 0.8])
    unit = direction / path.balance.angle(direction)
    allowed = CORRECTION * min(1.0, least / SOFT)

    def found(predicted, part):
        far = predicted + share * allowed * unit
        ahead.evaluation = ahead.evaluation._replace(q=far)
        return ahead

    monkeypatch.setattr(path, "equilibrium", found)
    monkeypatch.setattr(path, "_stray", lambda *middle: 0.0)
    assert (path.step(begin, 0.5) is ahead) == is_taken


def test_equilibria_that_are_not_stable_end_a_step(path, begin, monkeypatch):
    ahead = path.equilibrium(begin.evaluation.q, 0.5)
    ahead.stability = ahead.stability._replace(stable=False)
    monkeypatch.setattr(path, "equilibrium", lambda *guess: ahead)
    assert path.step(begin, 0.5) is None
    assert "buckles" in path.balance.obstacle
    ahead.stability = ahead.stability._replace(flutters=True)
    assert path.step(begin, 0.5) is None
    assert "flutter" in path.balance.obstacle


def test_equilibria_are_as_balanced_as_their_part_of_the_load_asks(path):
    """To round-off at the full load, from the straight arm."""
    straight = np.zeros(2)
    for part, residual in ((0.5, 1e-7), (1.0, 1e-10)):
        point = path.equilibrium(straight, part)
        assert point.evaluation.residual <= residual
        again = path.balance.linearise(point.evaluation.q, part)
        np.testing.assert_allclose(again.evaluation.force, point.evaluation.force)
        size = np.abs(again.stiffness).max()
        np.testing.assert_allclose(point.stiffness, again.stiffness, atol=1e-3 * size)


@pytest.mark.parametrize("h", [1e-3, 0.1, 10.0])
def test_the_flow_of_an_arm_that_settles_is_implicit(path, h):
    """(G + h S) change = h f with the symmetric part of S; infinite beyond what that holds."""
    point = path.balance.linearise(np.array([1.5, -0.7]), 1.0)
    symmetric = 0.5 * (point.stiffness + point.stiffness.T)
    system = point.evaluation.G + h * symmetric
    expected = np.linalg.solve(system, h * point.evaluation.force)
    np.testing.assert_allclose(_flow(point, h), expected, rtol=1e-9)
    # a motion that runs away by itself, faster than in a step of its time
    point.stiffness = -point.evaluation.G
    short = _flow(point, 0.5)
    expected_short = np.linalg.solve(point.evaluation.G, point.evaluation.force)
    np.testing.assert_allclose(short, expected_short)
    assert np.isinf(_flow(point, 2.0)).all()
