"""Trial of an arm: distances of the tip of its models from the converged reference.

By them `coordinate_search` finds coordinates, quadrature and time steps that keep it accurate.

A trial is made once, in seconds, under loads up to a multiple of the scene's and within its tension
limits. The arm is without obstacles, and without what lies between commands and tensions, but for
the friction of tendons and their elasticity.
"""

from __future__ import annotations

import numpy as np

from soft_tendon_env.accuracy.case_models import CaseModels, TrialInput
from soft_tendon_env.accuracy.choice import Choice
from soft_tendon_env.accuracy.hardest_motions import HardestMotions
from soft_tendon_env.accuracy.input_motions import (
    DURATION,
    HOLD,
    USUAL,
    slack_tensions,
    tension_limits,
)
from soft_tendon_env.accuracy.loads import load_cases, tried_effects
from soft_tendon_env.accuracy.progress import Progress
from soft_tendon_env.accuracy.reference import (
    Ladder,
    ReferenceMotion,
    distance,
    refine_once,
)
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.types import Array

SEED = 500
"""Seed of the tensions of every trial, and the first one of its motions."""

SECONDS = DURATION
"""Duration [s] of the motions, the hardest of some draws of each usual kind."""

MOST_WORK = 7e7
"""Work of the reference of a motion at most, in evaluations times coordinates squared: 3 to 7 s of
CPU time. Only arms whose damping is so light that motions last come near it."""

CERTAIN = 0.25
"""Largest error of the reference of a motion that is judged by it, in units of what is asked for.
What follows is not certain."""

LEAST_SECONDS = 0.2
"""Shortest time [s] through which a motion should be certain. Others are tried with smaller
tensions."""

SMALLER = 0.5
"""Factor of tensions of a motion that is not certain."""

MOST_SMALLER = 3
"""How often tensions are made smaller at most."""

RESTS = 16
"""Equilibria under random tensions, besides the slack arm's."""

MARGIN = 2.0
"""By how many times the error on these stays below what is asked for: other motions may be
worse."""

LARGER_LOADS_MARGIN = 1.25
"""As MARGIN, under the largest loads: the error is smaller under weaker ones."""

REFERENCE = 0.1
"""Error that is aimed at in full physics, as a share of what is asked for."""

UNSURE = 10.0
"""Largest error of full physics that anything is judged by, in units of what is asked for."""

FIRST_LEVELS = 2
"""Levels of full physics that every input gets; the finer ones where a decision depends on them."""

MOST_LEVELS = 3
"""Levels of full physics that an input gets at most."""

OWN = 0
"""Case of loads that are the scene's own."""

GREATEST = 1
"""Case of the largest loads that a trial holds for."""

WEAKER = 2
"""Case of smaller loads."""

TURNS = (OWN, GREATEST, OWN, WEAKER)
"""Cases of the inputs, in turn: half of them have the scene's own loads."""

SETTLED = 0.15
"""Share of what is asked for by which finer steps or intervals may change the tip."""

EVERY = 3
"""One of so many inputs is looked at when steps and quadrature are settled."""


class Trial:
    """Equilibria and motions of full physics, and distances of models from them."""

    def __init__(
        self, scene: Scene, share: float, reach: float = 1.0, progress: Progress | None = None
    ) -> None:
        """share: of the rod's length, that models should be judged by.

        reach: multiple of the scene's loads that inputs have. Raises ConfigurationError.
        """
        self.scene = scene.replace({"effects": tried_effects(scene.effects)})
        self.unit = share * rod_length(scene)
        self.reach = reach
        self.cases = load_cases(scene, reach, SEED)
        self._motions = HardestMotions(self.scene)
        if progress is None:
            self._progress = Progress(scene.name)
        else:
            self._progress = progress
        everything = self._inputs()
        self.inputs = len(everything)
        self.missing = 0
        self.not_unique = 0
        self.tests: list[TrialInput] = []
        self._compute(everything)

    @property
    def left_out(self) -> int:
        """Inputs that full physics leaves open, or under which it has no motion."""
        return self.missing + self.not_unique

    def _inputs(self) -> list[TrialInput]:
        """Tests before anything is computed: equilibria, then motions.

        Each takes turns with the cases of loads.
        """
        low, high = tension_limits(self.scene)
        random = np.random.default_rng(SEED)
        shares = random.random((RESTS, low.size))
        above = shares * (high - low)
        drawn = low + above
        rests = [slack_tensions(self.scene), *drawn]
        motions = [self._motions.hardest(kind, SEED, SECONDS) for kind in USUAL]

        ladders = []
        for effects in self.cases:
            loaded = self.scene.replace({"effects": effects})
            resolution = REFERENCE * self.unit
            ladders.append(Ladder(loaded, resolution))

        turns: tuple[int, ...] = (OWN,)
        if len(self.cases) > 1:
            turns = TURNS
        inputs = []
        for group in (rests, motions):
            for place, commands in enumerate(group):
                case = turns[place % len(turns)]
                motion = self._reference(ladders[case], commands)
                inputs.append(TrialInput(motion, case))
        return inputs

    def _reference(self, ladder: Ladder, commands: Array) -> ReferenceMotion:
        doubt = UNSURE * self.unit
        return ReferenceMotion(ladder, commands, MOST_WORK, doubt)

    def _compute(self, everything: list[TrialInput]) -> None:
        """Computes the reference to where it can judge.

        It keeps the tests that have a unique motion.
        """
        everything = self._with_unique_starts(everything)
        motions = [test.reference for test in everything]
        for motion in motions:
            for depth in range(FIRST_LEVELS):
                self._progress.plan(motion.size_at(depth))

        rests = [motion for motion in motions if motion.is_equilibrium]
        is_extended = len(self.cases) > 1
        if is_extended and self.not_unique:
            return  # larger loads buckle it: nothing is judged by them
        self._refine(rests)
        if is_extended and any(motion.tips is None for motion in rests):
            self.missing = len(motions)
            return
        moving = [motion for motion in motions if not motion.is_equilibrium]
        self._refine(moving)
        self._refine(motions)
        # finer where no model could be near enough to what is known so far
        for _ in range(FIRST_LEVELS, MOST_LEVELS):
            rough = [motion for motion in motions if not self._can_judge(motion)]
            without_tips = (motion.tips is None for motion in rough)
            if all(without_tips) and len(rough) < len(motions):
                break
            self._refine(rough)

        for test in everything:
            self._keep(test)

    def _keep(self, test: TrialInput) -> None:
        """Keeps a test that can be judged by, or counts it as left out."""
        for _ in range(MOST_SMALLER):
            if test.reference.is_equilibrium or self._is_certain(test.reference):
                break
            test = self._with_smaller_commands(test)
        reference = test.reference
        doubt = UNSURE * self.unit
        is_unsure = reference.error > doubt
        if not reference.is_equilibrium:
            is_unsure = not self._is_certain(reference)
        if reference.tips is None:
            self.missing += 1
        elif is_unsure:
            self.not_unique += 1
        else:
            certain_rows = self._certain_rows(reference)
            self.tests.append(test._replace(rows=certain_rows))

    def _certain_rows(self, reference: ReferenceMotion) -> int:
        """Rows of commands through which a reference can be judged by."""
        if reference.is_equilibrium:
            return 0
        return reference.rows_within(CERTAIN * self.unit)

    def _is_certain(self, reference: ReferenceMotion) -> bool:
        """Whether a motion is certain for long enough."""
        seconds = HOLD * self._certain_rows(reference)
        return seconds >= min(LEAST_SECONDS, SECONDS)

    def _with_smaller_commands(self, test: TrialInput) -> TrialInput:
        """The test of a motion with commands that are nearer to those of the slack arm."""
        slack = self._motions.slack
        pull = test.commands - slack
        commands = slack + SMALLER * pull
        smaller = self._reference(test.reference.ladder, commands)
        for _ in range(MOST_LEVELS):
            if self._can_judge(smaller):
                break
            smaller.refine()
        share = SMALLER * test.share
        return test._replace(reference=smaller, share=share)

    def _with_unique_starts(self, everything: list[TrialInput]) -> list[TrialInput]:
        """Tests without the motions that begin where a column may fall to any side."""
        unique = []
        for test in everything:
            motion = test.reference
            if not motion.is_equilibrium and motion.ladder.buckles:
                self.not_unique += 1
            else:
                unique.append(test)
        return unique

    def _can_judge(self, motion: ReferenceMotion) -> bool:
        """Whether a model could be within what is asked for by this reference, to its end."""
        if motion.is_equilibrium:
            part = 1.0 / MARGIN
        else:
            part = CERTAIN
        return motion.error <= part * self.unit

    def _refine(self, motions: list[ReferenceMotion]) -> None:
        """Computes the next level of full physics."""
        sizes = [motion.next_size for motion in motions]
        refine_once(motions, None, lambda place, _: self._progress.reference(sizes[place]))

    def model(self, choice: Choice) -> Model:
        """Model of a choice with the fewest of its quadrature intervals."""
        changed = choice.applied_to(self.scene)
        return model_on(changed, choice.quadrature["least"])

    def distance(self, model: Model, is_bounded: bool = False) -> float:
        """Bound of the tip's distance [m] from the reference, whose own uncertainty counts.

        is_bounded: inf where it is more than that, and too much for what is asked for.
        """
        models = CaseModels(self.cases, model)
        if self.tests:
            worst = 0.0
        else:
            worst = np.inf
        for test in list(self.tests):
            if is_bounded:
                enough = self._enough(test)
            else:
                enough = np.inf
            far = enough + test.bound
            path = models.path(test, far)
            self._decide(test, path, enough)
            error = test.bound
            away = test.distance(path)
            doubt = UNSURE * self.unit
            if not error <= doubt:  # refined, it turned out to be not unique
                self.tests.remove(test)
                self.not_unique += 1
                continue
            worst = max(worst, away + error)
            if away > max(enough, error):
                # it may well rule out the next model too
                self.tests.remove(test)
                self.tests.insert(0, test)
                return np.inf
        return worst

    def _enough(self, test: TrialInput) -> float:
        """Largest distance [m] of a tip that is near enough."""
        if test.case == GREATEST:
            margin = LARGER_LOADS_MARGIN
        else:
            margin = MARGIN
        return self.unit / margin

    def _decide(self, test: TrialInput, path: Array | None, enough: float) -> None:
        """Refines a reference until it says whether a path is near `enough` [m], or to the end."""
        least = REFERENCE * self.unit
        reference = test.reference
        while reference.depth < MOST_LEVELS and test.bound > least:
            away = test.distance(path)
            error = test.bound
            is_near = away + error <= enough
            is_far = away - error > enough
            is_finite = np.isfinite(enough)
            is_clear = is_finite and (is_near or is_far)
            if is_clear:
                return
            reference.refine()

    def growth(self, model: Model) -> Array:
        """Bounds of the tip's distance [m] from the reference in all motions up to each sample.

        They go beyond where the reference is certain; inf: not known.
        """
        models = CaseModels(self.cases, model)
        period_count = round(DURATION / HOLD)
        worst = np.zeros(period_count + 1)
        for test in self.tests:
            if not test.reference.is_equilibrium:
                bounds = models.bounds(test)
                known = len(bounds)
                worst_before = worst[:known]
                worst[:known] = np.maximum(worst_before, bounds)
                worst[known:] = np.inf
        return worst

    @property
    def seconds(self) -> float:
        """Time [s] through which all motions are certain."""
        times = [DURATION]
        for test in self.tests:
            is_motion = not test.reference.is_equilibrium
            if is_motion and test.rows < len(test.commands):
                times.append(HOLD * test.rows)
        return min(times)

    @property
    def share(self) -> float:
        """Part of the tensions of the usual motions that all motions had."""
        shares = (test.share for test in self.tests)
        return min(shares, default=1.0)

    def agree_at_rest(self, first: Choice, second: Choice, part: float = SETTLED) -> bool:
        """Whether the tips of two models with the same coordinates agree at some rests.

        They are apart by a part of what is asked for at most.
        """
        tests = [test for test in self.tests if test.reference.is_equilibrium]
        first_model = self.model(first)
        ours = CaseModels(self.cases, first_model)
        second_model = self.model(second)
        theirs = CaseModels(self.cases, second_model)
        for test in tests[::EVERY]:
            model = ours.model(test.case)
            rest = static_equilibrium(model, test.commands)
            if not rest.converged:
                continue
            # the coordinates are the same: Newton's method is there in a step or two
            denser = theirs.model(test.case)
            other = static_equilibrium(denser, test.commands, rest.q)
            moved = other.tip_pose - rest.tip_pose
            offset = moved[:3, 3]
            apart = float(np.linalg.norm(offset))
            if other.converged and apart > part * self.unit:
                return False
        return True

    def agree_in_motion(self, first: Choice, second: Choice, part: float = SETTLED) -> bool:
        """As `agree_at_rest`, in some motions, of models with any coordinates."""
        tests = [test for test in self.tests if not test.reference.is_equilibrium]
        first_model = self.model(first)
        ours = CaseModels(self.cases, first_model)
        second_model = self.model(second)
        theirs = CaseModels(self.cases, second_model)
        for test in tests[::EVERY]:
            path = ours.path(test)
            other = theirs.path(test)
            if path is None or other is None:
                continue
            allowed = part * self.unit
            if distance(path, other) > allowed:
                return False
        return True
