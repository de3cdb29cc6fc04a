"""Purpose of a training in words: its arm, and what it draws for every episode."""

from collections.abc import Iterator

from soft_tendon_env.envs.options import Options, given_scene
from soft_tendon_env.envs.randomization import OF_ACTUATORS, Randomization
from soft_tendon_env.learning.config import Training
from soft_tendon_env.scene.parameters import Range
from soft_tendon_env.scene.plausibility import scales_of
from soft_tendon_env.scene.scene import Scene

PURPOSE = "trained_for.txt"
"""Name of the file with these words in a training's folder."""

KINDS = {"value": "", "factor": " times its own", "offset": " more than its own"}
"""Words behind the ends of a range, by its kind."""


def purpose(training: Training) -> str:
    """Purpose of a training in words.

    Args:
        training: its configuration.

    Returns:
        Lines of text, with numbers in SI units.
    """
    options = Options.parse(training.options, "options")
    scene = given_scene(options.scene)
    lines = [
        f"{training.algorithm} on {training.task}, in SI units (m, kg, s, N, rad)",
        f"arm: {_arm(scene)}",
        f"control: every {options.control_period:g} s, actions are of the kind {options.action!r}",
        f"target: {_target(options)}",
        *_drawn(options.randomize, scene),
    ]
    return "\n".join(lines) + "\n"


def _arm(scene: Scene) -> str:
    """An arm by its sizes."""
    arm = scales_of(scene)
    effects = ", ".join(scene.effects.chosen()) or "none"
    return (
        f"{scene.name!r}, {arm.length:g} long, mass {arm.mass:.3g}, {len(scene.tendons)} tendons of"
        f" up to {arm.pull:g}, effects: {effects}"
    )


def _target(options: Options) -> str:
    """The target of options as a table."""
    if options.target is None:
        return "that of the task"
    return str(options.target.model_dump(mode="json", exclude_none=True))


def _drawn(randomize: Randomization, scene: Scene) -> Iterator[str]:
    """Lines of what is drawn for every episode."""
    yield "drawn for every episode, or for a share of the episodes:"
    for drawn in randomize.ranges(scene):
        ending = KINDS[drawn.kind]
        share = _share(randomize, drawn.name)
        yield f"  {_name(drawn)}: {drawn.least:g} to {drawn.greatest:g}{ending}{share}"
    nothing_drawn = Randomization()
    for name in OF_ACTUATORS:
        limits = getattr(randomize, name)
        if limits == getattr(nothing_drawn, name):
            continue
        least, greatest = limits
        yield f"  {name}: {least:g} to {greatest:g}{_share(randomize, name)}"
    deviations = []
    for name, value in randomize.noise.model_dump().items():
        if value:
            deviations.append(f"{name} {value:g}")
    share = _share(randomize, "noise")
    yield f"  noise, as deviations: {', '.join(deviations) or 'none'}{share}"


def _share(randomize: Randomization, name: str) -> str:
    """Share of the episodes that draw a number, as the end of its line; "" for all."""
    omission = randomize.omission(name)
    if not omission:
        return ""
    return f", in {1.0 - omission:.0%} of episodes"


def _name(drawn: Range) -> str:
    """Name of a range; of several that change together the first."""
    return drawn.name.partition("|")[0]
