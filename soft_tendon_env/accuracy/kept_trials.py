"""Trials that are kept in the user's cache.

Each holds for one arm, one accuracy, and loads up to those that were tried.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock

from soft_tendon_env.accuracy import coordinate_search
from soft_tendon_env.accuracy.candidates import bare_rod, known_fields
from soft_tendon_env.accuracy.choice import Accuracy, Choice
from soft_tendon_env.accuracy.loads import covers, tried_effects
from soft_tendon_env.effects import Effects
from soft_tendon_env.model.build import compiling_for
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.files import (
    digest,
    new_data_folder,
    read_json,
    replacing,
    sources_digest,
)
from soft_tendon_env.tools.messages import say_once

SOURCES = ("mechanics", "effects", "scene", "model", "accuracy")
"""Folders of the package that a trial depends on."""

DIGITS = 16
"""Hexadecimal digits of a digest."""


def choose(scene: Scene, asked: Accuracy, least: int = 0) -> Choice:
    """Choice of a trial of the arm, from the cache or made now.

    Raises ConfigurationError.

    least: number of coordinates that it has at least.
    """
    key = trial_digest(scene, asked)
    try:
        folder = new_data_folder("trials")
    except OSError:  # nothing can be kept
        return coordinate_search.search(scene, asked, least)
    with contextlib.ExitStack() as turn:  # one process makes it, the others find it
        # What cannot be locked may be made twice, as where the file system has no locks.
        with contextlib.suppress(OSError, NotImplementedError):
            lock = FileLock(folder / f"{key}.lock")
            turn.enter_context(lock)
        kept = kept_choice(folder, key, scene, least)
        if kept is not None:
            if not kept.speaks_of_all:
                description = kept.describe(scene)
                say_once(f"{scene.name!r}: {description}, by a trial that was kept")
            return kept
        say_once(
            f"the coordinates of {scene.name!r} are chosen by a trial of some seconds against a"
            f" converged reference, once for loads up to those that it tries: {folder}"
        )
        with compiling_for(scene):
            choice = coordinate_search.search(scene, asked, least)
        keep(folder, key, scene, choice)
    description = choice.describe(scene)
    percent = 100 * asked.share
    message = f"{scene.name!r}: {description}; the bound is {percent:.3g} %"
    say_once(message)
    return choice


def kept_choice(folder: Path, key: str, scene: Scene, least: int = 0) -> Choice | None:
    """Kept choice with the fewest coordinates, `least` or more; None: there is none.

    It is of those that were tried under loads as large as the scene's.
    """
    fitting = []
    for choice in _kept(folder, key, scene):
        is_enough = choice.coordinates >= least
        if is_enough and _reaches(choice, scene):
            fitting.append(choice)
    return min(fitting, key=lambda choice: choice.coordinates, default=None)


def _kept(folder: Path, key: str, scene: Scene) -> Iterator[Choice]:
    codes = effect_digests(tried_effects(scene.effects))
    for path in sorted(folder.glob(f"{key}_*.json")):
        try:
            file = read_json(path)
            record = file["choice"]
            if file["digest"] != _digest_of(_text_of(record)):
                continue
            tried = record.pop("codes")
            record["growth"] = tuple((seconds, bound) for seconds, bound in record["growth"])
            choice = Choice(**record)
        except (OSError, ValueError, TypeError, KeyError):  # damaged
            continue
        # an effect of the user's may have changed since
        is_same_code = all(tried.get(name) == code for name, code in codes.items())
        if is_same_code:
            yield choice


def _reaches(choice: Choice, scene: Scene) -> bool:
    """Whether the loads that were tried include the scene's."""
    try:
        effects = Effects(**(choice.loads or {}))
        return covers(effects, scene.effects)
    except ConfigurationError:  # of an effect that is not registered
        return False


def keep(folder: Path, key: str, scene: Scene, choice: Choice) -> None:
    """Writes a choice to the cache, if that can be written."""
    # a file for each range of loads
    loads = _text_of(choice.loads)
    name = f"{key}_{_digest_of(loads)}.json"
    path = folder / name

    record = choice._asdict()
    record["codes"] = effect_digests(tried_effects(scene.effects))
    digest_of_record = _digest_of(_text_of(record))
    text = json.dumps({"choice": record, "digest": digest_of_record})
    with contextlib.suppress(OSError), replacing(path) as temporary:
        temporary.write_text(text)


def effect_digests(effects: Effects) -> dict[str, str]:
    """Digests of the files that effects stand in, by name: they may be a user's own."""
    digests = {}
    for name, effect in effects.chosen().items():
        file = inspect.getfile(type(effect))
        digests[name] = digest(Path(file))
    return digests


@functools.cache
def code_digest() -> str:
    """Digest of the sources that a trial depends on."""
    patterns = (f"{folder}/**/*.py" for folder in SOURCES)
    return sources_digest(*patterns)


def trial_digest(scene: Scene, asked: Accuracy) -> str:
    """16 hex digits of all that a trial depends on besides loads.

    They are of arm, limits, elastic tendons, fields, what is asked for, and the code that simulates
    it.
    """
    apart = {"name", "description", "strain", "quadrature", "integrator", "effects"}
    fields = known_fields(scene)
    elasticity = scene.effects.tendon_elasticity
    made_of: list[Any] = [
        scene.model_dump(mode="json", exclude=apart),
        elasticity and elasticity.model_dump(mode="json"),
        bare_rod(scene),
        fields and fields.digest,
        asked,
        code_digest(),
    ]
    return _digest_of(_text_of(made_of))


def _text_of(values: Any) -> str:
    """JSON of values, the same for the same values, also after they were written and read."""
    return json.dumps(values, sort_keys=True)


def _digest_of(text: str) -> str:
    digest = hashlib.sha256(text.encode())
    return digest.hexdigest()[:DIGITS]
