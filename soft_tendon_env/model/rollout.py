"""Rollout of a plan by a simulation, with the linearisation that controllers and filters work with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion.advance import Scheme
from soft_tendon_env.mechanics.motion.period_map import Plan, linearised_rollout, make_plan
from soft_tendon_env.mechanics.motion.scratch import Motion, Scratch
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_array, checked_count, checked_number
from soft_tendon_env.tools.types import Array

SHORTEST = 1e-12  # [s], what may count as a period


class Rollout(NamedTuple):
    """Simulated motion over N periods and its linearisation: n coordinates, n_a tendons, m internal states of effects, k forces.

    The derivatives are those of a linearly implicit method with the matrices of the period's beginning: 2 to 15 percent of the largest
    entry off on most arms, near half of it on light stiff wires and in water, and all of it where an arm comes upon something, see
    docs/appendix/derivatives_measured.md. `Simulation.linearize` has differences of the motion itself.
    """

    q: Array  # (N + 1, n) where every period begins, and where the last one ends, as the next four
    q_dot: Array  # (N + 1, n)
    effects: Array  # (N + 1, m)
    tip_pose: Array  # (N + 1, 4, 4)
    tip_jacobian: Array  # (N + 1, 6, n) body Jacobian
    by_state: Array  # (N, 2 n, 2 n) of (q, q_dot) at the end of a period by those at its beginning
    by_tension: Array  # (N, 2 n, n_a) by tensions [N] added throughout it
    by_force: Array  # (N, 2 n, k) by generalised forces added throughout it


def checked_plan(model: Model, commands: ArrayLike, duration: ArrayLike, forces: ArrayLike | None) -> Plan:
    """Plan of what `Simulation.rollout` is given. Raises TypeError, ValueError."""
    n, n_a = model.coordinate_count, model.tendon_count
    parts = np.atleast_1d(checked_array("duration", duration, (None,) * np.ndim(duration)))
    played = checked_array("commands", commands, (None, n_a) if np.ndim(duration) == 0 else (None, parts.size, n_a))
    others = np.empty((n, 0)) if forces is None else checked_array("forces", forces, (n, None))
    checked_number("duration", float(parts.min(initial=0.0)), 0.0, "a number of seconds, at least 0")
    checked_number("duration", float(parts.sum()), SHORTEST, "a positive number of seconds")
    plan = make_plan(model.arm, checked_count("commands", len(played), 1), parts.size, others)
    plan.command[:] = played.reshape(plan.command.shape)
    plan.duration[:] = parts
    return plan


def roll_out(arm: Arm, scheme: Scheme, motion: Motion, steps: int, scratch: Scratch, plan: Plan) -> tuple[int, int, Rollout]:
    """Rollout from a motion, which is moved, of what a plan says; a status, and the period that failed or their number."""
    status, period = linearised_rollout(arm, scheme, motion, steps, scratch, plan)
    n, n_a = arm.strain.size, arm.tendons.size
    by = np.split(plan.jacobian, [2 * n, 2 * n + n_a], axis=2)
    return status, period, Rollout(plan.q, plan.q_dot, plan.state, plan.tip_pose, plan.tip_jacobian, *by)
