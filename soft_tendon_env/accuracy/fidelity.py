"""Fidelity: presets of accuracy against time, strain field, quadrature and integrator together, see docs/appendix/speed.md."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

from soft_tendon_env.accuracy.calibration import calibrated
from soft_tendon_env.accuracy.input_motions import USUAL
from soft_tendon_env.model import build
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.passive_fields import FieldsWarning, fields_of, find_fields
from soft_tendon_env.scene.scene import TIP_TOLERANCE, Integrator, Quadrature, Scene, rod_length
from soft_tendon_env.scene.strain import STRAINS, Snapshots, StaticsBased
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.types import is_length, read_length

AS_SCENE = "scene"  # the fidelity that leaves a scene as it is
UNSAID: Any = type("Unsaid", (), {"__repr__": lambda self: "UNSAID"})()
"""The fidelity of a model for which none is given: AS_SCENE, with a warning where that leaves the strain open."""


class FidelityWarning(UserWarning):
    """A model has other coordinates than an environment of its scene, and nobody said that it should."""


class Preset(NamedTuple):
    """Accuracy of each part of a simulation, as shares of the rod's length."""

    fields: float  # error of the passive fields on motions of the usual kinds: as many of the arm's own are taken, or all there are
    moments: int  # Legendre order of the passive moments over the rod, for an arm that has no fields of its own
    quadrature: Mapping[str, Any]
    tolerance: float  # of a time step


PRESETS: Mapping[str, Preset] = {
    "fast": Preset(8e-3, 1, {"tolerance": 5.0 * TIP_TOLERANCE, "least": 4}, 5e-4),
    "standard": Preset(1e-3, 2, {"tolerance": 5.0 * TIP_TOLERANCE, "least": 6}, 2.5e-5),
    "fine": Preset(2e-4, 6, {"tolerance": 0.4 * TIP_TOLERANCE, "least": 8}, 3e-6),
}
"""On the paper's arm of 1 m, with steps of 20 ms: 6 passive fields and 2 to 4 evaluations a step; 12 and 4 to 7; 24 and 7 to 10."""


def build_model(scene: Scene, fidelity: str | None = UNSAID) -> Model:
    """Model of a scene at a fidelity: chooses its quadrature and prepares the arrays of its kernels.

    fidelity: "fast", "standard" or "fine" are presets. "scene" takes strain, quadrature and integrator from the scene; a strain that it
    leaves open has one coordinate per tension and no others. A length such as "1mm" takes the result of a calibration for this tip error.
    None is "standard" for all that the scene leaves open, as in `gym.make`. Without the argument it is "scene", with a FidelityWarning if
    the scene leaves its strain open.

    Raises TypeError, ValueError for another fidelity, ConfigurationError for an arm that cannot be computed.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    if fidelity is UNSAID:
        if _leaves_strain_open(scene):
            text = "leaves its strain open, so that this model has the coordinates of the tensions alone and may be far off in motion"
            advice = "say fidelity='standard', as gym.make has it, or fidelity='scene' for this"
            warnings.warn(f"{scene.name!r} {text}: {advice}", FidelityWarning, stacklevel=2)
        fidelity = AS_SCENE
    if fidelity is not None:
        try:
            checked_fidelity(checked_type("fidelity", fidelity, str, "a preset or a length"))
        except ValueError as error:
            raise ValueError(f"fidelity is {fidelity!r}: {error}") from None
    return build.build_model(at_fidelity(scene, fidelity))


def at_fidelity(scene: Scene, fidelity: str | None) -> Scene:
    """The scene with the strain, quadrature and integrator of a fidelity, see `build_model`."""
    if fidelity == AS_SCENE:
        return scene
    if fidelity is not None and is_length(fidelity):
        return calibrated(scene, read_length(fidelity))
    preset, everything, changes = PRESETS[fidelity or "standard"], fidelity is not None, dict[str, Any]()
    if everything or _leaves_strain_open(scene):
        changes["strain"] = {**_rod_of(scene), "passive": _passive(scene, preset)}
    if everything or scene.quadrature == Quadrature():
        changes["quadrature"] = preset.quadrature
    if everything or scene.integrator == Integrator():
        changes["integrator"] = {"tolerance": preset.tolerance * rod_length(scene)}
    return scene.replace(changes)


def checked_fidelity(fidelity: str) -> str:
    """A fidelity that there is. Raises ValueError."""
    if is_length(fidelity):
        read_length(fidelity)
    elif fidelity not in (*PRESETS, AS_SCENE):
        raise ValueError(f"should be {', '.join(map(repr, PRESETS))}, {AS_SCENE!r} or a length such as '1mm'")
    return fidelity


def _leaves_strain_open(scene: Scene) -> bool:
    """True where the scene says nothing of coordinates besides those of the tensions."""
    return scene.strain == StaticsBased(**_rod_of(scene))


def _rod_of(scene: Scene) -> dict[str, Any]:
    """Strain table of the bare rod, without what is a matter of accuracy."""
    if isinstance(scene.strain, StaticsBased):
        return scene.strain.model_dump(include={"type", "strains", "borders", "rank_tolerance", "include_loads"})
    free = [strain for strain in STRAINS if strain in scene.strain.free]
    return {"type": "statics_based", "strains": free, "borders": scene.strain.borders}


def _passive(scene: Scene, preset: Preset) -> Any:
    """Table of the passive fields: the arm's own, those of the file that its scene names if it does, or Legendre moments."""
    named = scene.strain.passive if isinstance(scene.strain, StaticsBased) and isinstance(scene.strain.passive, Snapshots) else None
    fields = fields_of(scene) if named else find_fields(scene.replace({"strain": _rod_of(scene)}))
    if fields is not None:
        needed = fields.needed(preset.fields * rod_length(scene), USUAL)
        count = len(fields.coefficients) if needed is None else needed
        file = {"file": named.file} if named and named.file else {}
        return {"type": "snapshots", "fields": count, "digest": fields.digest, **file} if count else ()
    text = f"{scene.name!r} has no passive fields of its own, so that its accuracy is not known: Legendre moments up to order"
    text += f" {preset.moments} take their place; `soft-tendon fields SCENE` makes them in a minute"
    warnings.warn(text, FieldsWarning, stacklevel=2)
    angular = [strain for strain in STRAINS[:3] if strain in scene.strain.free]
    return [{"strains": angular, "order": preset.moments, "span": "rod"}] if angular else ()
