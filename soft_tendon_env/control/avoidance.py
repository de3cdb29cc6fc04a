"""Avoidance of obstacles as an objective: depth within a clearance, by signed distance.

The signed distance is that of contact, between the surfaces of obstacles and arm; nothing needs to
touch, and the model needs no contact.
"""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.control.objectives import LinearError, Objective, Posture, checked_weight
from soft_tendon_env.effects.contact.forces import Contact, read_gaps
from soft_tendon_env.effects.contact.obstacles import AnyObstacle
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.types import Array

STEP = 1e-4
"""Half the difference of a coordinate for derivatives, in units of `Model.coordinate_scale`: it
bends the arm by about 1e-4 rad, so that both cut-off and round-off are below 1e-6."""


class Avoidance(Objective):
    """Depth of the arm within a clearance of obstacles; zero where the arm keeps clear.

    Each obstacle counts by the point of the arm that is nearest to it, `weight` times: against an
    objective of weight 1 that pulls across, a depth of e / weight^2 is left of its error e.

    Args:
        model: of the arm.
        obstacles: those of `effects.contact.obstacles`, or tables as a scene has them; they move as
            they do there.
        clearance: distance [m] between the surfaces that is kept. On its way to a target behind an
            obstacle an arm uses up to a fifth of it.
        weight: of a metre against that of other objectives.
    """

    def __init__(
        self,
        model: Model,
        obstacles: Sequence[AnyObstacle],
        clearance: float,
        weight: float = 10.0,
    ) -> None:
        self._clearance = checked_number("clearance", clearance, 0.0, "a distance [m], at least 0")
        self._weight = checked_weight(weight)
        self._model = model
        rod = model.discretisation
        contact = Contact(obstacles=tuple(obstacles))
        self._parameters = contact.parameters(rod)
        self._count = len(contact.obstacles)
        self._places = contact.sample_places(rod)

    def linear_error(self, posture: Posture) -> LinearError:
        depth = self._depths(posture.q, posture.time)
        jacobian = np.zeros((self._count, posture.q.size))
        is_near = depth > 0.0
        if is_near.any():
            steps = STEP * self._model.coordinate_scale()
            for j, step in enumerate(steps):
                aside = np.zeros_like(posture.q)
                aside[j] = step
                deeper = self._depths(posture.q + aside, posture.time)
                shallower = self._depths(posture.q - aside, posture.time)
                # the error falls where the depth does
                jacobian[:, j] = (shallower - deeper) / (2.0 * step)
        return LinearError(
            self._weight * np.where(is_near, depth, 0.0),
            self._weight * np.where(is_near[:, None], jacobian, 0.0),
        )

    def gaps(self, q: Array, time: float = 0.0) -> Array:
        """Gaps (obstacles,) [m] between the arm's surface and those of obstacles at a time [s].

        Args:
            q: coordinates (n,).
            time: since the episode began.

        Returns:
            Least gaps along the arm, negative where surfaces overlap.
        """
        poses = self._model.backbone_at(q, self._places)
        gaps = np.empty((self._count, len(poses)))
        read_gaps(self._parameters, poses, time, gaps)
        return np.asarray(gaps.min(axis=1))

    def _depths(self, q: Array, time: float) -> Array:
        """Depths (obstacles,) [m] within the clearance, negative outside."""
        return self._clearance - self.gaps(q, time)
