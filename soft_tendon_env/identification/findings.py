"""Findings about an estimate in words: what the data do not contain, signs that the model lacks
something, data that were misread."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from soft_tendon_env.identification.fit import MOST_TRIALS, UNSEEN, Fit, fit
from soft_tendon_env.identification.markers import UNITS
from soft_tendon_env.identification.readings import Plants, Readings, mean_of_finite
from soft_tendon_env.identification.recordings import Recording, check_commands
from soft_tendon_env.tools.types import COMMANDS, Array

AT_BOUND = 1e-3  # distance from a bound, of that of both, at which a parameter is at it
EXACT = (
    1e-6  # error of data without noise, as a share of the rod's length: cameras see 1e-5 at best
)
CORRELATED, FEWEST = (
    0.3,
    100,
)  # correlation of successive residuals that are no noise, and pairs below which it may be chance
CHANCE, PERMUTATIONS = (
    0.005,
    999,
    # probability below which residuals follow the commands, and the permutations it is estimated
    # from
)
UNLIKELY = 5.0  # factor of a Young's modulus from which a unit may be wrong
OUTLYING, GROSS, FEW_OUTLIERS = (
    6.0,
    0.01,
    0.2,
)  # least distance of outliers, in medians of all and in lengths, and their greatest share
STILL = 0.005  # share of the rod's length within which markers may be at rest: noise
# root mean square residual, in parts of a known noise, from which the model lacks something
FAR = 1.5
MISREAD = (
    0.1,
    0.02,
    # mean errors from which data may be misread: shares of how far markers move, and of the rod's
    # length
)
BETTER, FEW, SAMPLES = (
    3.0,
    12,
    60,
)  # factor by which another reading explains some holds and samples of a motion far better
LACKING = (
    "the model lacks something that no parameter here makes up for, such as routing, a payload,"
    " friction, a gain or fidelity"
)
EXPERIMENTS = {
    "poisson_ratio": (
        "twist shows it: an asymmetric pair of tendons or a helix, with markers off the axis"
    ),
    "damping": "a free decay shows it",
    "actuators": "large steps of the commands show it",
    "delay": "steps of the commands show it",
    "friction": "a loading and unloading loop, or a free decay, shows it",
    "gain": "a known weight hung from the tip or a load cell shows it",
    "density": "holds in another direction of gravity, or weighing the arm, show it",
    "young_modulus": "a known weight hung from the tip shows it",
    **dict.fromkeys(
        ("base.position", "base.rotation"), "measure the base's pose, or record the arm at rest"
    ),
    "bending": "a known weight hung from the tip shows it",
    "retardation": "a free decay shows it",
    "mass_per_length": "holds in another direction of gravity, or weighing it, show it",
}
"""Experiments that show a parameter, by a part of its name; the first that fits."""


def findings(
    found: Fit, unseen: Sequence[Array], fitted: Readings, noise: float | None
) -> list[str]:
    """Findings about an estimate: that the data are misread, or what they do not contain and the
    model lacks. noise [m]: if it is known."""
    length, parameters = fitted.plants.model.length, fitted.plants.parameters
    spread = float(np.sqrt(np.ma.masked_invalid(fitted.measured).var(axis=0).sum(axis=-1).mean()))
    far = mean_of_finite(fitted.errors(found.x).values()) > min(
        MISREAD[0] * spread or np.inf, MISREAD[1] * length
    )
    if far and (text := misread_text(fitted, found.x, noise)):
        return [text]
    texts = list[str]()
    if not found.converged:
        text = (
            f"The fit did not converge in {MOST_TRIALS} trials of the parameters: estimate and"
            " intervals may be off"
        )
        texts.append(f"{text}. Estimate fewer, and none that the data do not contain.")
    for direction in unseen:
        names = [
            parameters[i].name
            for i in np.argsort(-np.abs(direction))
            if abs(direction[i]) >= UNSEEN
        ]
        what = names[0] if len(names) == 1 else f"a combination of {', '.join(names)}"
        texts.append(f"The data do not contain {what}: {_experiment(' '.join(names))}.")
    for one, x in zip(parameters, found.x, strict=True):
        for bound in one.bounds:
            if abs(x - bound) <= AT_BOUND * (one.bounds[1] - one.bounds[0]):
                texts.append(
                    f"{one.name} is at its bound, {one.at(bound):.4g}: {_experiment(one.name)}, or"
                    " the bound is wrong."
                )
        if one.name.endswith("young_modulus") and abs(x) > np.log(UNLIKELY):
            change = (
                f"{np.exp(abs(x)):.2g} times {'greater' if x > 0 else 'less'} than in the scene"
            )
            texts.append(
                f"{one.name} is {change}: is a unit wrong? Tensions in kg that are read as N make"
                " it 9.8 times less."
            )
    return texts + _misfit_texts(found, fitted, noise)


def _experiment(name: str) -> str:
    """Experiment that shows a parameter, or a combination of some."""
    return next(
        (text for part, text in EXPERIMENTS.items() if part in name),
        "holds that move it more show it, or measure it",
    )


def _misfit_texts(found: Fit, readings: Readings, noise: float | None) -> list[str]:
    """Signs of outliers, and that the model lacks something: residuals above a known noise [m], and
    those that follow each other."""
    residual, length, texts = (
        np.full(readings.measured.shape, np.nan),
        readings.plants.model.length,
        list[str](),
    )
    residual[readings.seen] = found.residual
    root = float(np.sqrt(np.nanmean(residual**2)))
    if root < EXACT * length:  # of simulated data
        return []
    if noise is not None and root > FAR * noise:
        texts.append(
            f"Residuals are {1e3 * root:.3g} mm where the noise is {1e3 * noise:.3g} mm: {LACKING}."
        )
    if follows := _following_commands(residual, readings):
        texts.append(
            f"Residuals of holds follow the commands, by {1e3 * follows:.2g} mm: {LACKING}."
        )
    parts = [*zip(readings.recordings, np.split(residual, readings.ends[:-1]), strict=True)]
    apart = [
        np.pad(0.5 * np.diff(part, 2, axis=0), ((1, 1), (0, 0), (0, 0))) if one.period else part
        for one, part in parts
    ]
    distance = np.linalg.norm(
        np.concatenate(apart), axis=-1
    )  # of samples of motions from the mean of their neighbours
    far = distance > max(OUTLYING * np.nanmedian(distance), GROSS * length)
    if 0 < far.sum() <= FEW_OUTLIERS * np.isfinite(distance).sum():
        sample, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
        name, hold = (
            [*readings.plants.markers.markers][marker],
            readings.recordings[np.searchsorted(readings.ends, sample, "right")].name,
        )
        text = (
            f"{far.sum()} of the markers' positions stand out, above all {name} in {hold!r},"
            f" {1e3 * np.nanmax(distance):.3g} mm off"
        )
        texts.append(f"{text}: outliers bias the estimate, leave their cells empty.")
    for one, part in parts:
        products = part[1:] * part[:-1]
        if (
            one.period
            and (moved := np.linalg.norm(one.positions[1] - one.positions[0], axis=-1).max())
            > STILL * length
        ):
            text = (
                f"Motion {one.name!r} does not begin at rest under its first command: markers move"
                f" {1e3 * moved:.2g} mm in the first"
            )
            texts.append(
                f"{text} period, at rest up to {1e3 * STILL * length:.2g} mm. Is the unit of time"
                " right?"
            )
        if np.isfinite(products).sum() >= FEWEST and (
            common := np.nanmean(products)
        ) > CORRELATED * np.nanmean(part**2):
            text = (
                f"Residuals of motion {one.name!r} are no noise: successive ones have"
                f" {1e3 * np.sqrt(common):.2g} mm in common"
            )
            texts.append(
                f"{text}: {LACKING}; viscous damping alone cannot make up for friction or"
                " hysteresis."
            )
    return texts


def _following_commands(residual: Array, readings: Readings) -> float:
    """Root mean square [m] of the part of the residuals (samples, m, 3) of holds that follows
    commands and their squares; 0 where that may be chance, by permutations (B. Phipson and G. K.
    Smyth 2010), or where holds are few."""
    commands = np.array([one.command[0] for one in readings.recordings if not one.period])
    if len(commands) <= 2 * len(readings.plants.scene.tendons) + 2:
        return 0.0
    columns = residual[: len(commands)].reshape(len(commands), -1)
    columns, random = columns[:, np.isfinite(columns).all(axis=0)], np.random.default_rng(0)
    U, values, _ = np.linalg.svd(
        np.hstack([np.ones((len(commands), 1)), commands, commands**2]), full_matrices=False
    )
    U = U[:, values > 1e-9 * values[0]]
    follows, *drawn = (
        ((U.T @ one) ** 2).sum()
        for one in (columns, *(random.permutation(columns) for _ in range(PERMUTATIONS)))
    )
    chance = (1 + sum(one >= follows for one in drawn)) / (1 + PERMUTATIONS)
    return float(np.sqrt(follows / columns.size)) if chance <= CHANCE else 0.0


def misread_text(readings: Readings, x: Array | None, noise: float | None) -> str | None:
    """Finding where another reading of axes, signs or units explains the data far better, or None.
    x (k,): the estimate, or None."""
    plants, start = readings.plants, np.zeros(len(readings.plants.parameters))
    holds, motions = (
        [one for one in readings.recordings if bool(one.period) == moves] for moves in (False, True)
    )
    few = [*holds[:: -(-len(holds) // FEW) or 1], *motions[:1]]
    few = [
        replace(one, command=one.command[:SAMPLES], positions=one.positions[:SAMPLES])
        for one in few
    ]
    frame, simulated = plants.markers.frame, _simulate(plants, few, start)
    tried = list[tuple[float, str, list[Recording]]]()
    for text, S in _axes().items():
        R = frame.rotation @ S @ frame.rotation.T
        read = [
            replace(one, positions=(one.positions - frame.translation) @ R.T + frame.translation)
            for one in few
        ]
        tried.append((_distance(simulated, read), text, read))
    for text, factor in _commands(plants).items():
        read = [replace(one, command=factor * one.command) for one in few]
        tried.append((_distance(_simulate(plants, read, start), read), text, read))
    _, text, read = min(tried, key=lambda one: one[0])
    given = _distance(simulated if x is None else _simulate(plants, few, x), few)
    try:
        least = max(
            _distance(_simulate(plants, read, fit(Readings(plants, read), noise).x), read),
            EXACT * plants.model.length,
        )
    except ValueError:
        return None
    if not BETTER * least < given:
        return None
    better = f"{given / least:.2g} times better" if np.isfinite(given) else "only"
    advice = (
        "Set it right in [columns] or [frame] of the markers' file, or in the scene; the estimate"
        " means nothing until then"
    )
    return (
        f"The data fit {better} with {text}: markers are off by {1e3 * least:.2g} mm then."
        f" {advice}."
    )


def _simulate(plants: Plants, recordings: Sequence[Recording], x: Array) -> Array:
    """Positions (samples, m, 3) [m] at coordinates x (k,); infinity where the arm does not hold the
    recordings."""
    try:
        for one in recordings:
            check_commands(one, plants.scene)
        return Readings(plants, recordings).positions(x)
    except ValueError:
        return np.array(np.inf)


def _distance(simulated: Array, recordings: Sequence[Recording]) -> float:
    """Mean distance [m] of simulated markers from those of recordings."""
    return float(
        np.nanmean(
            np.linalg.norm(
                simulated - np.concatenate([one.positions for one in recordings]), axis=-1
            )
        )
    )


def _axes() -> dict[str, Array]:
    """Other axes and signs of positions, as matrices (3, 3)."""
    found = {}
    for order, signs in itertools.product(
        itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)
    ):
        S = np.array(signs)[:, None] * np.eye(3)[list(order)]
        axes = ", ".join("-"[sign:] + "xyz"[i] for i, sign in zip(order, signs, strict=True))
        hand = (
            " (a mirror image: the frame of the data is left-handed)"
            if np.linalg.det(S) < 0.0
            else ""
        )
        found[f"x, y, z of the data read as {axes}{hand}"] = S
    return found


def _commands(plants: Plants) -> dict[str, float]:
    """The other sign of commands and other units, as factors."""
    unit = plants.scene.effects.command_unit
    columns = [
        column for key, column in plants.markers.columns.items() if key.startswith(COMMANDS[unit])
    ]
    given = next((UNITS[unit][column.unit] for column in columns if column.unit), 1.0)
    factors = {
        f"commands in {name}": factor / given
        for name, factor in UNITS[unit].items()
        if factor != given
    }
    return factors | {"commands of the other sign": -1.0}
