"""Diagnosis: what a Kalman filter has found out about an arm, in SI units with intervals.

A value and its standard deviation: 95 % of the true ones are within 1.96 deviations, if the filter
is honest.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.belief import Belief, StateSpace
from soft_tendon_env.control.innovations import Layout
from soft_tendon_env.tools.types import Array

NORMAL = 1.96
"""Standard deviations from the mean within which a Gaussian has 95 % of its values."""


class Quantity(NamedTuple):
    """Estimated quantity: a value and its standard deviation, arrays of one shape."""

    value: Array  # in SI units
    deviation: Array  # standard deviation, in the units of the value

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 95 % interval."""
        half = NORMAL * self.deviation
        return self.value - half, self.value + half


class Diagnosis(NamedTuple):
    """Estimated errors of a model, of n_a tendons and loads at p places."""

    latency: Quantity  # () [s] of commands
    lag: Quantity  # () [s] time constant of the actuators
    gain: Quantity  # (n_a,) of the tendons
    offset: Quantity  # (n_a,) [N] tensions that are added
    load_places: Array  # (p,) [m] arc lengths
    load: Quantity  # (p, 3) [N] forces in the world frame: gravity, payloads, pushes
    total_load: Quantity  # (3,) [N] their sum
    stiffness: Quantity  # () factor
    damping: Quantity  # () factor
    payload: Quantity  # () [kg] mass at the tip, by its inertia; its weight is a load
    # () coefficient of friction of the tendons, with one direction of sliding for all of a tendon,
    # which its deviation does not include
    friction: Quantity
    tip: Quantity  # (6,) [rad, m] body displacement from the model's tip to the arm's


def diagnosis(space: StateSpace, belief: Belief) -> Diagnosis:
    """Computes the diagnosis of a belief.

    Args:
        space: of the filter's state.
        belief: of the filter.

    Returns:
        Values and standard deviations.
    """
    layout = space.layout
    covariance = belief.covariance
    if belief.bank is not None:
        covariance = covariance + belief.bank.covariance
    deviations = np.sqrt(np.diag(covariance))

    def quantity(part: slice, shape: tuple[int, ...], nominal: float = 0.0) -> Quantity:
        value = nominal + belief.mean[part]
        return Quantity(value.reshape(shape), deviations[part].reshape(shape))

    tendons = (space.tension.size,)
    places = (space.places.size, 3)
    load = quantity(layout.load, places)
    return Diagnosis(
        latency=quantity(layout.latency, ()),
        lag=quantity(layout.lag, ()),
        gain=quantity(layout.gain, tendons, nominal=1.0),
        offset=quantity(layout.offset, tendons),
        load_places=space.places.copy(),
        load=load,
        total_load=Quantity(load.value.sum(axis=0), _total_deviation(layout, covariance)),
        stiffness=quantity(layout.stiffness, (), nominal=1.0),
        damping=quantity(layout.damping, (), nominal=1.0),
        payload=quantity(layout.payload, ()),
        friction=quantity(layout.friction, ()),
        tip=quantity(layout.tip, (6,)),
    )


def _total_deviation(layout: Layout, covariance: Array) -> Array:
    """Standard deviations (3,) of the sum of the loads."""
    axes = layout.load.stop - layout.load.start
    summed = np.tile(np.eye(3), axes // 3)
    of_loads = covariance[layout.load, layout.load]
    of_sum = summed @ of_loads @ summed.T
    return np.sqrt(np.diag(of_sum))
