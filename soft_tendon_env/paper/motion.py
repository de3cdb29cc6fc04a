"""Motions of an arm under a control law that is continuous in time, and the sampled form of (39).

The last is the package's tip tracker in TendonRod-TipPose-v0, on the same circle, at a control
period that can be kept.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from scipy.integrate import solve_ivp

import soft_tendon_env as ste
from soft_tendon_env.control.feedforward import ReferenceGovernor, StaticFeedforward
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.targets.shipped import Circle
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.policies.controller_policy import ControllerPolicy
from soft_tendon_env.tools.messages import say

TOLERANCE = 1e-4
"""Error tolerance of the integrator, relative, and absolute in coordinates and rates."""
APART = 1e-6
"""Step of finite differences in coordinates and rates, which are of the order of 10."""
SAMPLE_PERIOD = 0.005  # [s], of motions under continuous laws
PERIOD = 0.02  # [s], of control
ANGLE_LENGTH = 0.1  # length at which an angle counts as a distance, in lengths of the rod
LIMITS = (-60.0, 60.0)  # [N], of tensions
GAINS = {"settling_time": 0.396, "damping": 5.0, "integral_time": 0.5}
"""Gains that are kp and kd of the paper at vanishing periods, and an integral: times in s."""

Law = Callable[[float, np.ndarray, np.ndarray, ste.Terms], np.ndarray]
"""Tensions (n_a,) [N] from time [s], q, q_dot (n,) and the terms there."""


class Motion(NamedTuple):
    """Samples; they end early where the integrator finds no further step."""

    time: np.ndarray  # (m,) [s]
    q: np.ndarray  # (m, n)
    tip: np.ndarray  # (m, 3) [m]
    tension: np.ndarray  # (m, n_a) [N]


class ClosedLoop:
    """x_dot = f(t, x) with x = (q, q_dot)."""

    def __init__(self, model: ste.Model, law: Law) -> None:
        self.model = model
        self.law = law

    def rate(self, t: float, x: np.ndarray) -> np.ndarray:
        q, q_dot = np.split(x, 2)
        terms = self.model.terms(q, q_dot)
        tension = self.law(t, q, q_dot, terms)
        actuation = terms.actuation @ tension
        force = actuation + terms.external_force
        loss = terms.damping @ q_dot
        without_springs = force - terms.bias - loss
        unbalanced = without_springs - terms.elastic_force
        q_ddot = np.linalg.solve(terms.mass, unbalanced)
        return np.concatenate([q_dot, q_ddot])

    def jacobian(self, t: float, x: np.ndarray) -> np.ndarray:
        """df/dx.

        The differences that SciPy would choose by itself are so coarse that its Newton iterations
        hardly converge.
        """
        rate = self.rate(t, x)
        columns = []
        for step in APART * np.eye(x.size):
            rate_ahead = self.rate(t, x + step)
            change = rate_ahead - rate
            columns.append(change / APART)
        return np.stack(columns, axis=1)


def integrate(
    loop: ClosedLoop,
    duration: float,
    label: str,
) -> Motion:
    """Closed-loop motion from rest without tension, over `duration` [s]."""
    n = loop.model.coordinate_count
    period_count = round(duration / SAMPLE_PERIOD)
    numbers = np.arange(period_count + 1)
    times = SAMPLE_PERIOD * numbers
    say(f"{label}: {duration:g} s")

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        try:
            return loop.rate(t, x)
        except (ste.StrainLimitError, OverflowError):
            return np.full_like(x, np.nan)  # from which integrators turn back

    solution = solve_ivp(
        rate,
        (0.0, times[-1]),
        np.zeros(2 * n),
        method="Radau",
        rtol=TOLERANCE,
        atol=TOLERANCE,
        jac=loop.jacobian,
        t_eval=times,
    )
    # tensions are no states: the law gives them once more at the samples
    states = solution.y.T
    tip = []
    tension = []
    for t, x in zip(solution.t, states, strict=True):
        q, q_dot = np.split(x, 2)
        pose = loop.model.tip_pose(q)
        position = pose[:3, 3]
        tip.append(position)
        terms = loop.model.terms(q, q_dot)
        command = loop.law(t, q, q_dot, terms)
        tension.append(command)
    return Motion(
        solution.t,
        states[:, :n],
        np.array(tip),
        np.array(tension),
    )


def below_for_good(
    time: np.ndarray,
    error: np.ndarray,
    threshold: float,
) -> float:
    """First time [s] from which on the error stays below the threshold.

    It is infinite if the error is not below at the end.
    """
    beyond = np.flatnonzero(error >= threshold)
    first = beyond.max(initial=-1) + 1
    if first < time.size:
        return float(time[first])
    return float("inf")


def when(time: float) -> str:
    """Words for a result of `below_for_good`."""
    if time == 0.0:
        return "always"
    if np.isinf(time):
        return "never for good"
    return f"from {time:.2f} s"


def track(
    scene: str,
    circle: Circle,
    duration: float,
) -> Motion:
    """Episode of `duration` [s], sampled at the ends of the control periods.

    Tensions are those of the period that ends.
    """
    count = round(duration / PERIOD)
    options: dict[str, Any] = {
        "scene": scene,
        "target": circle.model_dump(),
        "tension_limits": LIMITS,
        "control_period": PERIOD,
        "preview": (PERIOD, 2.0 * PERIOD),
    }
    env = gym.make(IDS["TipPose"], action="tension", max_episode_steps=count, **options)
    episodes = episodes_of(env)
    model = episodes.model
    limits = episodes.limits
    aim = TipPose(ANGLE_LENGTH * model.length)
    # inverse statics leads, and (39) for sampled commands follows what it can reach
    controller = ReferenceGovernor(
        StaticFeedforward(model, limits, PERIOD, aim),
        TipTracking(model, limits, PERIOD, aim, **GAINS),
    )
    title = f"Figures 5 and 6, {scene} at {1e3 * PERIOD:g} ms"
    say(title)
    q = []
    tip = []
    tension = []
    policy = ControllerPolicy(controller, env)
    for step in play_steps(policy, env, [0]):
        # the next step overwrites what the environment has now
        coordinates = episodes.arms.rows.q[0].copy()
        q.append(coordinates)
        row_position = episodes.arms.reading.tip_pose[0, :3, 3]
        position = row_position.copy()
        tip.append(position)
        tension.append(episodes.tension[0].copy())
        if step.ended.any():
            break
    numbers = np.arange(len(q))
    time = PERIOD * numbers
    return Motion(
        time,
        np.stack(q),
        np.stack(tip),
        np.stack(tension),
    )
