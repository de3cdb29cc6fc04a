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
SAMPLE_PERIOD, PERIOD = 0.005, 0.02  # [s], of motions under continuous laws, and of control
LIMITS = (-60.0, 60.0)  # [N]
GAINS = {
    "settling_time": 0.396,
    "damping": 5.0,
    "integral_time": 0.5,
}  # kp and kd of the paper at vanishing periods, and an integral

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
        self.model, self.law = model, law

    def rate(self, t: float, x: np.ndarray) -> np.ndarray:
        q, q_dot = np.split(x, 2)
        terms = self.model.terms(q, q_dot)
        force = terms.actuation @ self.law(t, q, q_dot, terms) + terms.external_force
        return np.concatenate(
            [
                q_dot,
                np.linalg.solve(
                    terms.mass, force - terms.bias - terms.damping @ q_dot - terms.elastic_force
                ),
            ]
        )

    def jacobian(self, t: float, x: np.ndarray) -> np.ndarray:
        """df/dx. The differences that SciPy would choose by itself are so coarse that its Newton
        iterations hardly converge."""
        here = self.rate(t, x)
        return np.stack(
            [(self.rate(t, x + d) - here) / APART for d in APART * np.eye(x.size)], axis=1
        )


def integrate(loop: ClosedLoop, duration: float, label: str) -> Motion:
    """Closed-loop motion from rest without tension, over `duration` [s]."""
    n, times = (
        loop.model.coordinate_count,
        SAMPLE_PERIOD * np.arange(round(duration / SAMPLE_PERIOD) + 1),
    )
    say(f"{label}: {duration:g} s")

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        try:
            return loop.rate(t, x)
        except (ste.StrainLimitError, OverflowError):
            return np.full_like(x, np.nan)  # from which integrators turn back

    options = {"rtol": TOLERANCE, "atol": TOLERANCE, "jac": loop.jacobian, "t_eval": times}
    found = solve_ivp(rate, (0.0, times[-1]), np.zeros(2 * n), method="Radau", **options)
    states = found.y.T
    tip = np.array([loop.model.tip_pose(x[:n])[:3, 3] for x in states])
    tension = np.array(
        [
            loop.law(t, x[:n], x[n:], loop.model.terms(x[:n], x[n:]))
            for t, x in zip(found.t, states, strict=True)
        ]
    )
    return Motion(found.t, states[:, :n], tip, tension)


def below_for_good(time: np.ndarray, error: np.ndarray, threshold: float) -> float:
    """The first time [s] from which on the error stays below the threshold; infinity if it is not
    below at the end."""
    first = np.flatnonzero(error >= threshold).max(initial=-1) + 1
    return float(time[first]) if first < time.size else float("inf")


def when(time: float) -> str:
    """Words for a result of `below_for_good`."""
    return "always" if time == 0.0 else "never for good" if np.isinf(time) else f"from {time:.2f} s"


def track(scene: str, circle: Circle, duration: float) -> Motion:
    """An episode of `duration` [s], sampled at the ends of the control periods; tensions are those
    of the period that ends."""
    count = round(duration / PERIOD)
    options: dict[str, Any] = {
        "scene": scene,
        "target": circle.model_dump(),
        "tension_limits": LIMITS,
        "control_period": PERIOD,
    }
    env = gym.make(
        IDS["TipPose"],
        action="tension",
        preview=(PERIOD, 2.0 * PERIOD),
        max_episode_steps=count,
        **options,
    )
    episodes = episodes_of(env)
    model, limits, aim = episodes.model, episodes.limits, TipPose(0.1 * episodes.model.length)
    controller = ReferenceGovernor(
        StaticFeedforward(model, limits, PERIOD, aim),
        TipTracking(model, limits, PERIOD, aim, **GAINS),
    )
    samples = []
    say(f"Figures 5 and 6, {scene} at {1e3 * PERIOD:g} ms")
    for step in play_steps(ControllerPolicy(controller, env), env, [0]):
        arms = episodes.arms
        samples.append(
            (
                arms.rows.q[0].copy(),
                arms.reading.tip_pose[0, :3, 3].copy(),
                episodes.tension[0].copy(),
            )
        )
        if step.ended.any():
            break
    return Motion(
        PERIOD * np.arange(len(samples)),
        *(np.stack(values) for values in zip(*samples, strict=True)),
    )
