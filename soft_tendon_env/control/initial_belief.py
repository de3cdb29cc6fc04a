"""Belief when an episode begins, and where a filter has lost the arm.

An arm at rest is bent by the loads that it carries. So the first covariance has coordinates and
loads together, by the statics

    z = z_0 + K^-1 (B (offset, gain u) + J^T f - s K q)

and the first measurement tells the loads at once.
"""

import numpy as np

from soft_tendon_env.control import timing_bank
from soft_tendon_env.control.belief import Belief, StateSpace
from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.innovations import Surprise
from soft_tendon_env.control.timing_bank import Bank
from soft_tendon_env.control.uncertainty import Setting
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.types import Array

LOST = 0.3
"""Standard deviation of scaled coordinates where the filter has lost the arm."""
LOST_RATE = 5.0
"""Standard deviation of the rates [1/s] of scaled coordinates where the filter has lost the arm."""
RATE = 10.0
"""Uncertainty of rates [1/s] in units of that of scaled coordinates, at rest."""


class InitialBelief:
    """Beliefs to begin with.

    Args:
        space: of the state.
        setting: sensors and actuators.
        tension: (n_a,) [N] that hold the arm.
        greatest: latency and lag [s] that are estimated, or known.
    """

    def __init__(
        self, space: StateSpace, setting: Setting, tension: Array, greatest: Timing
    ) -> None:
        start = setting.uncertainty
        self.space = space
        self._tension = tension
        self._known = Timing(setting.latency, setting.lag)
        self._greatest = greatest
        self._lag_probability = start.lag_probability
        self.rest = static_equilibrium(space.model, tension).q
        simulation = Simulation(space.model)
        self._effects = simulation.reset(self.rest, tension=tension).effects
        self._variance = space.variances(
            z=start.state_start,
            v=RATE * start.state_start,
            offset=start.offset_start * space.tension,
            gain=start.gain_start,
            tip=start.tip_start * space.tip,
            load=start.load_start * space.weight,
            stiffness=start.stiffness_start,
            damping=start.damping_start,
            payload=start.payload_start * space.mass,
            friction=start.friction_start,
            latency=0.0,
            lag=0.0,
        )

    def at_rest(self, q: Array) -> Belief:
        """Belief at rest, with the statics linearised about coordinates q (n,)."""
        layout = self.space.layout
        locality = self.space.locality(q, np.zeros_like(q))
        bank = self._bank()
        mean = np.zeros(layout.size)
        mean[layout.z] = self.rest / self.space.scale
        timing = self._greatest if bank is None else bank.moments()[0]
        mean[layout.latency], mean[layout.lag] = timing
        terms = locality.terms
        columns = np.zeros((q.size, layout.size))
        columns[:, layout.offset] = terms.actuation
        columns[:, layout.gain] = terms.actuation * self._tension
        columns[:, layout.load] = locality.load_jacobian
        columns[:, layout.stiffness] = -terms.elastic_force[:, None]
        stiffness = terms.stiffness + terms.external_stiffness
        sag = np.eye(layout.size)
        static = np.linalg.solve(stiffness, columns)
        sag[layout.z] += static / self.space.scale[:, None]
        motion = layout.v.stop
        return Belief(
            mean=mean,
            covariance=(sag * self._variance) @ sag.T,
            noise=np.zeros((motion, motion)),
            jump=np.zeros((layout.size, 3 * self.space.places.size)),
            effects=self._effects,
            bank=bank,
            locality=locality,
            surprise=Surprise(),
        )

    def lost(self, last: Belief) -> Belief:
        """Belief where the filter has lost the arm: it knows all but where the arm is."""
        layout = self.space.layout
        motion = slice(layout.v.stop)
        mean = last.mean.copy()
        mean[layout.v] = 0.0
        covariance = last.covariance.copy()
        covariance[motion] = 0.0
        covariance[:, motion] = 0.0
        deviations = np.repeat([LOST, LOST_RATE], self.space.scale.size)
        covariance[motion, motion] = np.diag(deviations**2)
        bank = last.bank
        if bank is not None:
            deviation = bank.deviation.copy()
            deviation[motion] = 0.0
            bank = bank._replace(deviation=deviation)
        return last._replace(mean=mean, covariance=covariance, bank=bank)

    def _bank(self) -> Bank | None:
        """Bank of timings; None where the timing is known."""
        if None not in self._known:
            return None
        layout = self.space.layout
        bank = timing_bank.first_bank(
            layout.size, self._known, self._greatest, self._lag_probability
        )
        means, _ = bank.moments()
        bank.deviation[layout.latency] = bank.timing.latency - means.latency
        bank.deviation[layout.lag] = bank.timing.lag - means.lag
        return bank
