"""Derivatives by numbers of a scene: differences of fourth order between models of the same arm with numbers a little off."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import Parameter
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

CENTRAL = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
AHEAD = {0: -25.0 / 12.0, 1: 4.0, 2: -3.0, 3: 4.0 / 3.0, 4: -0.25}
"""Weights of values so many steps away that give a derivative, of fourth order; the second where numbers can only grow."""
BEHIND = {-k: -weight for k, weight in AHEAD.items()}
Evaluate = Callable[[Model, float], Array]
SHARE = 1e-3
"""Step as a share of a number's size: the error of fourth order is a millionth of a millionth, and rounding is far below a millionth."""
TOUCHING = 1e-2
"""Factor of all steps where the arm may touch something: contact forces set in over a small way."""
RECENT = 32
"""Parameters whose models are kept: period after period of a motion is differentiated by the same."""
STEPS_FROM_ZERO, SEEN = (1e-8, 1e-6, 1e-4, 1e-2, 1.0), 1e-5
"""Steps of a number that is zero, of which the first that changes so much is taken: its unit does not tell what is small."""


def step_factor(model: Model) -> float:
    """Factor of the steps of differences, for an arm as smooth as this one."""
    return TOUCHING if any(effect.is_encountered for effect in model.scene.effects.chosen().values()) else 1.0


def derivative_by(model: Model, parameter: Parameter, evaluate: Evaluate, share: float = SHARE) -> Array:
    """Derivative of an array that is computed from a model by a parameter of its scene; one-sided where numbers end, as Poisson's ratio at
    0.5 and a mass at 0.

    evaluate: from a model with another number, and by how much that is off, to an array whose entries are of order 1 where much changes.
    share: step as a share of the number's size. Raises ConfigurationError.
    """
    step = step_factor(model) * share * (1.0 if parameter.is_factor else parameter.size)
    return _difference(model, parameter, step, evaluate)[0] if step else _derivative_from_zero(model, parameter, evaluate)


def _derivative_from_zero(model: Model, parameter: Parameter, evaluate: Evaluate) -> Array:
    found = np.zeros(0)
    for step in STEPS_FROM_ZERO:
        try:
            found, change = _difference(model, parameter, step, evaluate)
        except (ConfigurationError, StrainLimitError, FloatingPointError):
            if found.size:  # a long step leads to what cannot be
                break
            raise
        if change >= SEEN:
            break
    return found


def _difference(model: Model, parameter: Parameter, step: float, evaluate: Evaluate) -> tuple[Array, float]:
    """The derivative with one step, and by how much the array changes between the outermost numbers."""
    values = [(weight, evaluate(other, change)) for weight, change, other in _beside(model, parameter, step)]
    slope = np.asarray(sum(weight * value for weight, value in values) / step)
    return slope, float(np.abs(values[-1][1] - values[0][1]).max(initial=0.0))


@lru_cache(maxsize=RECENT)
def _beside(model: Model, parameter: Parameter, step: float) -> tuple[tuple[float, float, Model], ...]:
    """Weights, changes of a parameter and models with these, on both sides or on one."""
    problems: list[ConfigurationError] = []
    for weights in (CENTRAL, AHEAD, BEHIND):
        try:
            others = {k: model.with_numbers(parameter.changes(parameter.value + k * step)) for k in weights}
            return tuple((weight, k * step, others[k]) for k, weight in weights.items())
        except ConfigurationError as problem:
            problems.append(problem)
    raise problems[0]
