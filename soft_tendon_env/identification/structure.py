"""Structure of residuals: faults of the drawing or of the tensions that would leave such residuals as a fit did.

Score tests: the derivative of the readings by each fault, less what the estimated parameters can make up for, against the residuals; the
probability of chance by Student's t over holds, since errors within one are common (D. D. Boos, The American Statistician 46, 1992).
"""

import contextlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.fit import Fit
from soft_tendon_env.identification.parameters import Parameter, distance_parameter, read_parameters
from soft_tendon_env.identification.plant import Plants
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.recordings import COMMANDS
from soft_tendon_env.identification.simulated import NoHoldError
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

FEWEST = 5
"""Holds with commands of their own from which residuals are tested."""
MADE_UP = 1e-3
"""Share of what a fault changes, beside what the parameters make up for, below which the data do not show it."""

PLAUSIBLE = 0.3
"""Error of a drawing or a gain, as a share, beyond which a fault is not named; of an offset its bounds."""
STEP = 1e-3
"""Change of a dimensionless coordinate for differences."""


class Suspect(NamedTuple):
    """Fault that would leave such residuals."""

    what: str  # in words, behind "as if"
    probability: float  # of chance, with as many tests as there are of its kind
    explained: float  # share of the sum of squared residuals


class _Fault(NamedTuple):
    """Change of parameters by a common amount."""

    what: str  # {} for the amount
    unit: str  # of the amount, "%" of a factor
    more: str
    less: str
    parameters: Sequence[Parameter]
    tests: int  # of its kind

    @property
    def most(self) -> float:
        """Amount that is plausible."""
        return PLAUSIBLE if self.unit == "%" else min(own.high for own in self.parameters)

    def words(self, amount: float) -> str:
        """The fault with its amount."""
        size = f"{(100.0 if self.unit == '%' else 1.0) * abs(amount):.2g} {self.unit}"
        return self.what.format(f"{size} {self.more if amount > 0.0 else self.less}")


def suspects(found: Fit, readings: Readings) -> list[Suspect]:
    """Faults that residuals of holds look like, the one that explains most first; none with motions or too few holds."""
    from scipy.stats import ttest_1samp  # here: it takes longer to import than all else that most scenes need

    clusters = int(readings.group.max()) + 1
    if clusters < FEWEST or any(own.period for own in readings.recordings):
        return []
    root, prior = np.sqrt(found.weight) / found.sigma, np.sqrt(found.prior)
    Q, _ = np.linalg.qr(np.vstack([root[:, None] * found.jacobian, np.diag(prior)]))
    residual = np.concatenate([root * found.residual, prior * found.x])
    plants, faults, tested = readings.plants, _faults(readings.plants), list[Suspect]()
    more = dict.fromkeys(own for fault in faults for own in fault.parameters)
    faulty = readings.with_plants(Plants(plants.scene, plants.model, plants.markers, [*plants.parameters, *more]))
    for fault in faults:
        with contextlib.suppress(NoHoldError, ConfigurationError):
            effect = np.concatenate([root * _effect(fault, found, faulty), np.zeros(prior.size)])
            alone = effect - Q @ (Q.T @ effect)
            squares = float(alone @ alone)
            if squares > MADE_UP**2 * float(effect @ effect):
                products = alone * residual
                scores = np.bincount(readings.cluster, products[: root.size])
                scores = np.append(scores, products[root.size :].sum()) if prior.any() else scores
                size, chance = -float(scores.sum()) / squares, float(ttest_1samp(scores, 0.0).pvalue)
                explained = size**2 * squares / float(residual @ residual)
                if abs(size) <= fault.most:
                    tested.append(Suspect(fault.words(size), fault.tests * chance, explained))
    return sorted(tested, key=lambda own: -own.explained)


def _effect(fault: _Fault, found: Fit, readings: Readings) -> Array:
    """Derivative (N,) of the readings by the amount of a fault, by a difference. Raises NoHoldError, ConfigurationError."""
    amount, parameters = STEP * min(own.scale for own in fault.parameters), readings.plants.parameters
    steps = [amount / own.scale if own in fault.parameters else 0.0 for own in parameters[found.x.size :]]
    return (readings.residual(np.concatenate([found.x, steps])) - found.residual) / amount


def _faults(plants: Plants) -> list[_Fault]:
    """Faults of parameters that are not estimated: distances of all tendons, and offsets and gains of commands."""
    scene, tendons = plants.scene, len(plants.scene.tendons)
    known = {key for own in plants.parameters for key in own.keys}
    kind, unit = COMMANDS[scene.effects.command_unit], scene.effects.command_unit
    offset, gain = (read_parameters([f"commands.*.{name}"], scene, plants.markers) for name in ("offset", "gain"))
    distance = distance_parameter(scene)
    found = [_Fault(f"all {kind}s were {{}} than recorded", unit, "higher", "lower", offset, 2)]
    for i in range(tendons):
        found.append(_Fault(f"{kind}_{i} were {{}} than recorded", unit, "higher", "lower", offset[i : i + 1], 2 * tendons))
        found.append(_Fault(f"{kind}_{i} were {{}} than recorded", "%", "higher", "lower", gain[i : i + 1], 2 * tendons))
    if distance is not None:
        found.append(_Fault("all tendons lay {} the axis than drawn", "%", "further from", "closer to", [distance], 2))
    return [fault for fault in found if not known & {key for own in fault.parameters for key in own.keys}]
