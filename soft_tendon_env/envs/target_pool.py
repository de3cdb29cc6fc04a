"""Pools of targets, for trainings: courses drawn once for a scene, with all that statics say of them, kept in the user's cache.

Statics of targets take longer than all else in a step: inverse statics at every control period, equilibria under loads at every reset. An
episode with a pool reads one of its courses, from a drawn control period on, and begins it again where it ends, without a jump.
"""

import functools
import hashlib
import json
from pathlib import Path

import numpy as np

from soft_tendon_env.accuracy.calibration import found_or_made
from soft_tendon_env.compiler.cache_folder import data_folders, new_data_folder
from soft_tendon_env.compiler.code_digest import code_digest, sources_digest
from soft_tendon_env.envs.courses import TargetPool
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import Options, check_fit, groups_of, resolved_scene
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.tasks import Task
from soft_tendon_env.scene.artifacts.passive_fields import fields_of
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import ExplicitStrain, Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import MOST_BINARY, read_arrays, replacing
from soft_tendon_env.tools.messages import say_unless_quiet
from soft_tendon_env.tools.parallel import run_all

FIRST_SEED = 2**64
"""Seed of the first course; the others follow, one apart: beyond all seeds of `reset` that have a purpose."""
MOST_DRAWS = 100
"""Draws of a course after which it is an error that inverse statics never come back to where they were a period before."""
BLOCK = 8
"""Courses that a process makes at a time."""
KEPT = 8
"""Pools that are kept in the cache, those that were made last."""
SOURCES = ("control/*.py", "effects/**/*.py", "envs/**/*.py", "mechanics/**/*.py", "model/*.py", "scene/**/*.py")
"""The files of the package that courses depend on."""

Block = tuple[Task, Options, int, range]
"""Task, options without a pool, control periods until targets repeat, and numbers of courses."""


def target_pool(task: Task, options: Options, workers: int = 1) -> TargetPool | None:
    """The pool of an environment with these options, from the cache, or made and kept there; None where `target.pool` asks for none.

    It depends on the scene, the target, the control period and on whether inverse statics are observed, not on what is drawn of the arm:
    targets are those of the scene's arm.

    Args:
        task: of the environment.
        options: of the environment.
        workers: processes that make it, see `run_all`.

    Raises ConfigurationError where options do not fit, or the pool is too large; OSError where there is no cache folder.
    """
    target = options.target
    if target is None or target.pool is None:
        return None
    own = options.model_copy(update={"target": target.model_copy(update={"pool": None}), "randomize": Randomization()})
    scene, count = resolved_scene(own), target.pool
    check_fit(options, task, resolved_scene(options))
    assert target.repeats_after is not None, "which is checked"
    periods = round(target.repeats_after / own.control_period)
    path = new_data_folder("targets") / f"{_digest(task, own, scene, count)}.npz"

    def make() -> TargetPool:
        _check_size(Episodes(task, own, 1), count, periods)
        say_unless_quiet(f"{count} courses of the target {target.type!r} are made for trainings, once: {path}")
        blocks = [(task, own, periods, range(first, min(first + BLOCK, count))) for first in range(0, count, BLOCK)]
        made = run_all(_courses, blocks, workers, "courses", unit="block")
        pool = TargetPool(*(np.concatenate(parts) for parts in zip(*made, strict=True)))
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **pool._asdict())
        for outdated in sorted(path.parent.glob("*.npz"), key=lambda made: made.stat().st_mtime)[:-KEPT]:
            outdated.unlink(missing_ok=True)
        return pool

    return found_or_made(lambda: _kept(path.name), path, make)


def _courses(block: Block) -> TargetPool:
    """Courses of a block."""
    task, options, periods, numbers = block
    episodes = Episodes(task, options, 1)
    return TargetPool(*map(np.stack, zip(*(_course(episodes, number, periods) for number in numbers), strict=True)))


def _course(episodes: Episodes, number: int, periods: int) -> TargetPool:
    """One course, (periods, ..): of a draw to which inverse statics come back. Raises ConfigurationError."""
    generator = np.random.default_rng(FIRST_SEED + number)
    for _ in range(MOST_DRAWS):
        if (found := episodes.target_period(generator, periods)) is not None:
            return TargetPool(*found)
    text = f"needs inverse statics that repeat with the target, and those of {MOST_DRAWS} draws out of {MOST_DRAWS} do not"
    raise ConfigurationError([Problem(("target", "pool"), text)], "environment")


def _check_size(episodes: Episodes, count: int, periods: int) -> None:
    """Raises ConfigurationError where the file would be too large to be read."""
    size = 8 * periods * episodes.target_numbers
    most = (MOST_BINARY - 2**16) // size  # less what the archive says of itself
    if count > most:
        text = f"is {count}: it should be at most {most}, whose courses of {periods} control periods take {MOST_BINARY >> 20} MiB"
        raise ConfigurationError([Problem(("target", "pool"), text)], "environment")


def _digest(task: Task, options: Options, scene: Scene, count: int) -> str:
    """16 hex digits of all that the courses depend on, and of the code that makes them."""
    target = options.target
    strain, inverse = scene.strain, any(group.of_inverse for group in groups_of(options, task, scene).values())
    snapshots = not isinstance(strain, ExplicitStrain) and isinstance(strain.passive, Snapshots)
    fields = fields_of(scene).digest if snapshots else None
    code = [code_digest(type(own)) for own in (target, *scene.effects.chosen().values())]
    made_of = [scene.model_dump(mode="json"), fields, options.model_dump(mode="json", include={"target", "control_period"}), code]
    content = json.dumps([made_of, task.shapes, inverse, count, sources_digest(*SOURCES)], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _kept(name: str) -> TargetPool | None:
    """The pool in a file of the cache; None where there is none, or a damaged one."""
    for folder in data_folders("targets"):
        try:
            return _read(folder / name)
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            say_unless_quiet(f"{folder / name} is damaged, and made anew: {error}")
    return None


@functools.lru_cache(maxsize=2)
def _read(path: Path) -> TargetPool:
    pool = TargetPool(**read_arrays(path, TargetPool._fields, "pool of targets"))
    for array in pool:
        array.flags.writeable = False  # all environments of this process share it
    return pool
