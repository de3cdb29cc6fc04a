"""Fidelity: presets of accuracy against time, see docs/appendix/speed.md.

They set strain field, quadrature and integrator together.

A preset is an error: the largest distance of the tip from full physics, as a share of the rod's
length, at rest under tensions within limits and in the usual motions, see input_motions.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from soft_tendon_env.accuracy.candidates import bare_rod, known_fields, snapshots
from soft_tendon_env.accuracy.choice import Accuracy, Choice
from soft_tendon_env.accuracy.input_motions import USUAL
from soft_tendon_env.accuracy.kept_trials import choose
from soft_tendon_env.accuracy.loads import has_strengths, reaches, tried_effects
from soft_tendon_env.model import build
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.passive_fields import FidelityWarning, PassiveFields
from soft_tendon_env.scene.scene import TIP_TOLERANCE, Integrator, Quadrature, Scene, rod_length
from soft_tendon_env.scene.strain import StaticsBased
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import is_length, read_length

AS_SCENE = "scene"
"""Fidelity that leaves a scene as it is."""

DEFAULT = "standard"
"""Fidelity of `gym.make` for all that a scene leaves open."""


ALIKE_MARGIN = 2.5
"""Factor by which errors of an arm may be larger than those of the arm that its fields were made
for, whose material and limits differ by a quarter: 1.7 to 2.6 were measured on the paper's arm,
softer, less damped and pulled harder."""

LIGHT_FRICTION = 0.05
"""Largest coefficient of friction of tendons with which the errors of passive fields hold: those
that were made without any lack what it bends. At 0.1 the paper's arm is 0.06 % of the length off at
"fine", at 1.0 the helical one 1.4 % at every preset."""

LITTLE_STRETCH = 0.01
"""Largest stretch of elastic tendons at their limits, as a share of the rod's length, with which
the errors of passive fields hold. At 0.01 those of the arms that ship are no larger than with stiff
tendons; at 0.05 the paper's arm is 1.5 % off at "fast"."""


class Unsaid:
    """Type of the default argument of `build_model`."""

    def __repr__(self) -> str:
        return "UNSAID"


UNSAID: Any = Unsaid()
"""Fidelity of a model for which none is given: AS_SCENE, with a warning where that leaves the
strain open."""

PRESETS: Mapping[str, Accuracy] = {
    "fast": Accuracy(
        share=1e-2, fields=8e-3, quadrature=5.0 * TIP_TOLERANCE, least=4, tolerance=5e-4
    ),
    "standard": Accuracy(
        share=2e-3, fields=1e-3, quadrature=5.0 * TIP_TOLERANCE, least=6, tolerance=2.5e-5
    ),
    "fine": Accuracy(
        share=5e-4, fields=2e-4, quadrature=0.4 * TIP_TOLERANCE, least=8, tolerance=3e-6
    ),
}
"""On the paper's arm of 1 m, with steps of 20 ms: 6 passive fields and 2 to 4 evaluations a step;
12 and 4 to 7; 24 and 7 to 10."""


def build_model(scene: Scene, fidelity: str | None = UNSAID) -> Model:
    """Builds the model of a scene: chooses its coordinates and quadrature at a fidelity.

    The presets "fast", "standard" and "fine" are errors of the tip of 1, 0.2 or 0.05 % of the
    length. A length such as "1mm" is this error. "scene" takes strain, quadrature and integrator
    from the scene; a strain that it leaves open has one coordinate per tension and no others. None
    is "standard" for all that the scene leaves open, as in `gym.make`. Without the argument it is
    "scene", with a FidelityWarning if the scene leaves its strain open.

    Args:
        scene: the arm, its effects and its solver settings.
        fidelity: a preset, a length, "scene" or None.

    Returns:
        The model of the scene, whose arrays the compiled kernels read.

    Raises:
        TypeError: for a scene or a fidelity of another type.
        ValueError: for a fidelity that is neither a preset nor a length.
        ConfigurationError: for an arm that cannot be computed.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    if fidelity is UNSAID:
        if _leaves_strain_open(scene):
            text = (
                "leaves its strain open, so that this model has the coordinates of the tensions"
                " alone and may be far off in motion"
            )
            advice = "say fidelity='standard', as gym.make has it, or fidelity='scene' for this"
            message = f"{scene.name!r} {text}: {advice}"
            warnings.warn(message, FidelityWarning, stacklevel=2)
        fidelity = AS_SCENE
    if fidelity is not None:
        try:
            checked_fidelity(checked_type("fidelity", fidelity, str, "a preset or a length"))
        except ValueError as error:
            raise ValueError(f"fidelity is {fidelity!r}: {error}") from None
    return build.build_model(at_fidelity(scene, fidelity))


def at_fidelity(scene: Scene, fidelity: str | None) -> Scene:
    """The scene with the strain, quadrature and integrator of a fidelity, see `build_model`.

    They are found by a short trial of the arm, once, unless it has passive fields of its own that
    were made for its loads: the errors of these are known. Raises ConfigurationError where nothing
    keeps within a length; warns where nothing reaches a preset.
    """
    if fidelity == AS_SCENE:
        return scene
    is_strain_open = _leaves_strain_open(scene)
    if fidelity is None and not is_strain_open:
        return _with_open_parts(scene, _parts_without_strain(scene, DEFAULT))
    parts = _parts(scene, fidelity or DEFAULT)
    if fidelity is None:
        return _with_open_parts(scene, parts)
    return scene.replace(parts)


def _with_open_parts(scene: Scene, parts: dict[str, Any]) -> Scene:
    """The scene with those of the parts that it says nothing of."""
    is_open = {
        "strain": _leaves_strain_open(scene),
        "quadrature": scene.quadrature == Quadrature(),
        "integrator": scene.integrator == Integrator(),
    }
    open_parts = {name: table for name, table in parts.items() if is_open[name]}
    return scene.replace(open_parts)


def _parts(scene: Scene, fidelity: str) -> dict[str, Any]:
    """Tables of strain, quadrature and integrator at a fidelity.

    They are of fields whose errors are known, or of a trial.
    """
    asked = accuracy_of(scene, fidelity)
    fields = known_fields(scene)
    if fields is not None and _are_measured(fields, scene) and not is_length(fidelity):
        is_own = fields.is_of(scene)
        if is_own:
            margin = 1.0
        else:
            margin = ALIKE_MARGIN
        allowed = asked.fields * rod_length(scene)
        needed = fields.needed(allowed / margin, USUAL)
        if needed is None and is_own:
            needed = len(fields.coefficients)
        if needed is not None:
            return {
                "strain": snapshots(scene, fields, needed),
                **_parts_without_strain(scene, fidelity, margin),
            }
    choice = _chosen(scene, asked, fidelity)
    _check(scene, choice, asked, fidelity)
    return {
        "strain": choice.strain,
        "quadrature": choice.quadrature,
        "integrator": choice.integrator,
    }


def _chosen(scene: Scene, asked: Accuracy, fidelity: str) -> Choice:
    """Choice of a trial.

    Where that is not certain of everything, it has no fewer coordinates and states no larger error
    than the next coarser preset, whose trial may have judged by what it left out.
    """
    choice = choose(scene, asked)
    names = list(PRESETS)
    is_coarsest = fidelity == names[0]
    if is_length(fidelity) or is_coarsest or _is_within(choice, asked, scene):
        return choice
    name = names[names.index(fidelity) - 1]
    coarser = _chosen(scene, PRESETS[name], name)
    if choice.coordinates < coarser.coordinates:
        choice = choose(scene, asked, coarser.coordinates)
    if choice.error <= coarser.error:
        return choice
    return coarser


def _is_within(choice: Choice, asked: Accuracy, scene: Scene) -> bool:
    """Whether a choice keeps what is asked for in all inputs, under the largest loads of a trial.

    The next coarser preset has no more coordinates then: this choice would have been near enough.
    The trial may have begun with other loads than the scene's, which are within its range.
    """
    is_under_all = choice.reach >= reaches(scene)[0]
    return choice.error <= asked.share and choice.speaks_of_all and is_under_all


def _parts_without_strain(scene: Scene, fidelity: str, margin: float = 1.0) -> dict[str, Any]:
    """Tables of quadrature and integrator of a preset, as on arms that ship.

    margin: factor by which time steps are more accurate.
    """
    asked = accuracy_of(scene, fidelity)
    return {
        "quadrature": {"tolerance": asked.quadrature, "least": asked.least},
        "integrator": {"tolerance": asked.tolerance * rod_length(scene) / margin},
    }


def accuracy_of(scene: Scene, fidelity: str) -> Accuracy:
    """Accuracy that a preset or a length asks for.

    Its parts are those of the coarsest preset that is fine enough.
    """
    if not is_length(fidelity):
        return PRESETS[fidelity]
    share = read_length(fidelity) / rod_length(scene)
    near = PRESETS["fine"]
    for preset in PRESETS.values():
        if preset.share <= share:
            near = preset
            break
    finer = min(share / near.share, 1.0)  # than the finest preset
    return near._replace(
        share=share, quadrature=finer * near.quadrature, tolerance=finer * near.tolerance
    )


def _are_measured(fields: PassiveFields, scene: Scene) -> bool:
    """Whether the errors of passive fields hold for this arm.

    They were measured under its loads, or it has none; without friction, or its own is light; and
    with stiff tendons, or its own are nearly so.
    """
    if fields.misfit(scene):
        return False
    loads = scene.effects.everywhere()
    is_under_loads = loads == fields.effects or not has_strengths(loads)
    return is_under_loads and _has_smooth_tendons(scene) and _has_stiff_tendons(scene)


def _has_smooth_tendons(scene: Scene) -> bool:
    """Whether the friction of tendons is light, or there is none."""
    friction = tried_effects(scene.effects).tendon_friction
    return friction is None or friction.coefficient <= LIGHT_FRICTION


def _has_stiff_tendons(scene: Scene) -> bool:
    """Whether the greatest tension stretches tendons by little of the rod's length, or by none."""
    elasticity = tried_effects(scene.effects).tendon_elasticity
    if elasticity is None:
        return True
    greatest = max(tendon.tension_limits[1] for tendon in scene.tendons)
    stretch = greatest / elasticity.stiffness
    return stretch <= LITTLE_STRETCH * rod_length(scene)


def _check(scene: Scene, choice: Choice, asked: Accuracy, fidelity: str) -> None:
    """Raises ConfigurationError where a choice does not keep within a length.

    Warns where it does not reach a preset, or is not certain of all motions.
    """
    growth = choice.describe_growth(asked.share)
    if choice.error <= asked.share:
        if not choice.speaks_of_all:
            text = (
                f"{scene.name!r} is within what {fidelity!r} promises,"
                f" {100 * asked.share:.3g} % of the length, only in a trial{choice.limits}"
            )
            if growth:
                text += f": {growth}"
            warnings.warn(text, FidelityWarning, stacklevel=4)
        return
    if np.isfinite(choice.error):
        text = (
            f"{scene.name!r} has no coordinates that keep its tip as near to full physics as"
            f" {fidelity!r} asks, {100 * asked.share:.3g} % of the length: the best there are,"
            f" {choice.describe(scene)}"
        )
        if growth:
            text += f" ({growth})"
    else:
        text = f"the accuracy of {scene.name!r} is not known: {choice.obstacle}"
    if is_length(fidelity):
        raise ConfigurationError([Problem((), text)])
    warnings.warn(text, FidelityWarning, stacklevel=4)


def checked_fidelity(fidelity: str) -> str:
    """A fidelity that there is.

    Raises ValueError.
    """
    if is_length(fidelity):
        read_length(fidelity)
    elif fidelity not in (*PRESETS, AS_SCENE):
        raise ValueError(
            f"should be {', '.join(map(repr, PRESETS))}, {AS_SCENE!r} or a length such as '1mm'"
        )
    return fidelity


def _leaves_strain_open(scene: Scene) -> bool:
    """True where the scene says nothing of coordinates besides those of the tensions."""
    return scene.strain == StaticsBased(**bare_rod(scene))
