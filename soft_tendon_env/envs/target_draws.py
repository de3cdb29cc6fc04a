"""Targets of episodes: drawn clear of obstacles, under loads from a bank of motions, with goals that are yet to be reached."""

import warnings
from typing import Any

import numpy as np

from soft_tendon_env.envs.contacts import why_target_inside
from soft_tendon_env.envs.targets import Course, Setting, ShapeCourse, Target
from soft_tendon_env.envs.trajectories import TargetTrajectories
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import rests_at_tensions
from soft_tendon_env.registration import MAX_EPISODE_STEPS
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

MOST_DRAWS = 200
"""How often targets are drawn inside of obstacles before that is an error, and goals that are reached already before they are taken."""
BANK = 64
"""Motions in a bank, each with as many beginnings as it has control periods."""
BANK_SEED = 2**64
"""Seed of the first motion of a bank; the others follow, one apart: beyond all seeds of `reset` that have a purpose."""
CHECKS = 100
"""Times in an episode of the usual length at which a target is checked not to lie inside of obstacles."""


class TargetDraws:
    """Draws of targets for the rows of an environment.

    Under loads a motion takes many equilibria. There, one of BANK motions is drawn in place of a new one, and the control period of it at
    which the episode begins. A motion of the bank depends on target and number alone, is computed when it is first asked for, and stays.
    """

    def __init__(self, setting: Setting, trajectories: TargetTrajectories, period: float, away: float = 0.0) -> None:
        """period: of control [s]; away: distance [m] that goals have from where the tip begins, 0: any."""
        self._setting, self._trajectories, self._period, self._away = setting, trajectories, period, away
        self._has_bank = not rests_at_tensions(setting.model if setting.free is None else setting.free.model)
        self._bank: dict[tuple[str, int], Course] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bank": {}}  # of which every motion can be computed again

    def settled(self, target: Target) -> Target | Course:
        """The course of a target; one that is drawn as it is. Raises ConfigurationError where the course cannot be, or lies inside of an
        obstacle."""
        if target.is_random:
            return target
        course = target.draw(np.random.default_rng(0), self._setting)
        if inside := self.inside(course, self._setting.arms.model):
            raise ConfigurationError([Problem(("target",), f"lies inside of an obstacle: {inside}")], "environment")
        return course

    def inside(self, course: Course, model: Model) -> str:
        """Obstacle standing still that a target's tip is inside of, as the end of a sentence; "": none."""
        if model.scene.effects.contact is None:
            return ""
        times = self._period * np.linspace(0.0, MAX_EPISODE_STEPS, CHECKS)
        return why_target_inside(model, self._trajectories.tip_positions(course, times))

    def begin(self, row: int, target: Target | Course, generator: np.random.Generator, setting: Setting, tip: Array) -> None:
        """Give a row its target, a drawn one clear of obstacles, with a goal away from the tip (3,) unless it begins at rest.

        Raises ConfigurationError where all draws are inside of obstacles; where all goals are reached a warning says so.
        """
        if not isinstance(target, Target):
            self._trajectories.begin(row, target)
            return
        away = 0.0 if target.begins_at_rest else self._away
        for _ in range(MOST_DRAWS):
            course, first = self._drawn(target, generator, setting)
            inside = "" if isinstance(course, ShapeCourse) else self.inside(course, setting.model)
            if not inside and (not away or self._distance(course, first, tip) > away):
                break
        else:
            if inside:
                text = f"lay inside of an obstacle in {MOST_DRAWS} draws out of {MOST_DRAWS}, at last {inside}"
                raise ConfigurationError([Problem(("target",), text)], "environment")
            text = f"a goal was within the threshold, {1e3 * away:.3g} mm, of where the tip begins in {MOST_DRAWS} draws"
            warnings.warn(f"{text}: the episode begins solved; choose a smaller threshold, or a larger fraction of tensions", stacklevel=2)
        self._trajectories.begin(row, course, first)

    def _drawn(self, target: Target, generator: np.random.Generator, setting: Setting) -> tuple[Course, int]:
        """A course, and the control period of it to begin at."""
        if not self._has_bank or target.repeats is None or setting is not self._setting:  # rows with obstacles of their own
            return target.draw(generator, setting), 0
        number, first = (int(generator.integers(most)) for most in (BANK, max(round(target.repeats / self._period), 1)))
        return self._motion(target, number), first

    def _motion(self, target: Target, number: int) -> Course:
        """The motion of that number in the bank."""
        key = target.model_dump_json(), number
        if key not in self._bank:
            self._bank[key] = target.draw(np.random.default_rng(BANK_SEED + number), self._setting)
        return self._bank[key]

    def fill_bank(self, target: Target | Course) -> None:
        """Compute all motions of a target in the bank ahead, so that no reset waits for them. Raises ConfigurationError."""
        if self._has_bank and isinstance(target, Target) and target.repeats is not None:
            for number in range(BANK):
                self._motion(target, number)

    def _distance(self, course: Course, first: int, tip: Array) -> float:
        """Distance [m] from the tip (3,) to where a course begins, as it is observed."""
        (goal,) = self._trajectories.tip_positions(course, np.array([self._period * first])).astype(np.float32)
        return float(np.linalg.norm(goal - tip))
