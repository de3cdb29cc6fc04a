"""Trial of an arm: coordinates, quadrature and time steps that keep its tip accurate.

The tip is within a share of its length of the converged reference.

A trial is made once, in seconds, under loads up to a multiple of the scene's and within its tension
limits. The arm is without obstacles, and without what lies between commands and tensions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from soft_tendon_env.accuracy.candidates import known_fields, strain_tables
from soft_tendon_env.accuracy.case_models import CaseModels, TrialInput
from soft_tendon_env.accuracy.choice import Accuracy, Choice
from soft_tendon_env.accuracy.input_motions import (
    USUAL,
    motion_tensions,
    slack_tensions,
    tension_limits,
)
from soft_tendon_env.accuracy.loads import load_cases, reaches
from soft_tendon_env.accuracy.progress import Progress
from soft_tendon_env.accuracy.reference import (
    Ladder,
    ReferenceMotion,
    distance,
    refine_once,
)
from soft_tendon_env.accuracy.settling import settle
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.reference_model import part_borders
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.scene import (
    Scene,
    extrapolation_columns,
    rod_length,
)
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

SEED = 500
"""Seed of the motions and tensions of every trial."""

SECONDS = 2.0
"""Duration [s] of the motions, one of each usual kind; less where they take long to compute."""

PARTS_COST = 1.0
"""By how much more of its time an arm in several parts takes: its motions are so much shorter."""

UNDAMPED_COST = 3.0
"""As PARTS_COST, of an arm whose damping leaves it short steps."""

UNDAMPED_COLUMNS = 2
"""Columns of extrapolation that an arm with so little damping is left with."""

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

RICHEST = 3
"""Candidates with the most coordinates, of which the best is taken where none is near enough."""


class Trial:
    """Equilibria and motions of full physics, and distances of models from them."""

    def __init__(
        self, scene: Scene, share: float, reach: float = 1.0, progress: Progress | None = None
    ) -> None:
        """share: of the rod's length, that models should be judged by.

        reach: multiple of the scene's loads that inputs have. Raises ConfigurationError.
        """
        self.scene = scene.replace({"effects": scene.effects.everywhere()})
        self.unit = share * rod_length(scene)
        self.cases = load_cases(scene, reach, SEED)
        self._progress = Progress(scene.name) if progress is None else progress
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
        shares = np.random.default_rng(SEED).random((RESTS, low.size))
        drawn = low + shares * (high - low)
        rests = [slack_tensions(self.scene), *drawn]
        duration = self._seconds()
        motions = [motion_tensions(self.scene, kind, SEED, duration) for kind in USUAL]

        ladders = []
        for effects in self.cases:
            loaded = self.scene.replace({"effects": effects})
            ladders.append(Ladder(loaded, REFERENCE * self.unit))

        turns = TURNS if len(self.cases) > 1 else (OWN,)
        inputs = []
        for group in (rests, motions):
            for place, tensions in enumerate(group):
                case = turns[place % len(turns)]
                motion = ReferenceMotion(ladders[case], tensions)
                inputs.append(TrialInput(motion, case))
        return inputs

    def _seconds(self) -> float:
        """Duration [s] of the motions."""
        factor = 1.0
        if part_borders(self.scene):
            factor += PARTS_COST
        free_steps = self.scene.replace({"integrator": {}})
        if extrapolation_columns(free_steps) <= UNDAMPED_COLUMNS:
            factor += UNDAMPED_COST
        return SECONDS / factor

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
        self._refine([motion for motion in motions if not motion.is_equilibrium])
        self._refine(motions)
        # finer where no model could be near enough to what is known so far
        for _ in range(FIRST_LEVELS, MOST_LEVELS):
            rough = [motion for motion in motions if not self._can_judge(motion)]
            if all(motion.tips is None for motion in rough) and len(rough) < len(motions):
                break
            self._refine(rough)

        for test in everything:
            if test.reference.tips is None:
                self.missing += 1
            elif test.reference.error > UNSURE * self.unit:
                self.not_unique += 1
            else:
                self.tests.append(test)

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
        """Whether a model could be within what is asked for by this reference."""
        return motion.tips is not None and motion.error <= self.unit / MARGIN

    def _refine(self, motions: list[ReferenceMotion]) -> None:
        """Computes the next level of full physics."""
        sizes = [motion.next_size for motion in motions]
        refine_once(motions, None, lambda place, _: self._progress.reference(sizes[place]))

    def model(self, choice: Choice) -> Model:
        """Model of a choice with the fewest of its quadrature intervals."""
        return model_on(choice.applied_to(self.scene), choice.quadrature["least"])

    def distance(self, model: Model, is_bounded: bool = False) -> float:
        """Bound of the tip's distance [m] from the reference, whose own uncertainty counts.

        is_bounded: inf where it is more than that, and too much for what is asked for.
        """
        models = CaseModels(self.cases, model)
        worst = 0.0 if self.tests else np.inf
        for test in list(self.tests):
            enough = self._enough(test) if is_bounded else np.inf
            path = models.path(test, enough + test.reference.error)
            self._decide(test.reference, path, enough)
            error = test.reference.error
            away = distance(path, test.reference.tips)
            if not error <= UNSURE * self.unit:  # refined, it turned out to be not unique
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
        margin = LARGER_LOADS_MARGIN if test.case == GREATEST else MARGIN
        return self.unit / margin

    def _decide(self, reference: ReferenceMotion, path: Array | None, enough: float) -> None:
        """Refines a reference until it says whether a path is near `enough` [m], or to the end."""
        least = REFERENCE * self.unit
        while reference.depth < MOST_LEVELS and reference.error > least:
            away = distance(path, reference.tips)
            error = reference.error
            is_near = away + error <= enough
            is_far = away - error > enough
            is_clear = np.isfinite(enough) and (is_near or is_far)
            if is_clear:
                return
            reference.refine()

    def agree_at_rest(self, first: Choice, second: Choice, part: float = SETTLED) -> bool:
        """Whether the tips of two models with the same coordinates agree at some rests.

        They are apart by a part of what is asked for at most.
        """
        tests = [test for test in self.tests if test.reference.is_equilibrium]
        ours = CaseModels(self.cases, self.model(first))
        theirs = CaseModels(self.cases, self.model(second))
        for test in tests[::EVERY]:
            model = ours.model(test.case)
            rest = static_equilibrium(model, test.tensions)
            if not rest.converged:
                continue
            # the coordinates are the same: Newton's method is there in a step or two
            denser = theirs.model(test.case)
            other = static_equilibrium(denser, test.tensions, rest.q)
            moved = other.tip_pose - rest.tip_pose
            apart = float(np.linalg.norm(moved[:3, 3]))
            if other.converged and apart > part * self.unit:
                return False
        return True

    def agree_in_motion(self, first: Choice, second: Choice, part: float = SETTLED) -> bool:
        """As `agree_at_rest`, in some motions, of models with any coordinates."""
        tests = [test for test in self.tests if not test.reference.is_equilibrium]
        ours = CaseModels(self.cases, self.model(first))
        theirs = CaseModels(self.cases, self.model(second))
        for test in tests[::EVERY]:
            path = ours.path(test)
            other = theirs.path(test)
            if path is None or other is None:
                continue
            if distance(path, other) > part * self.unit:
                return False
        return True


def search(scene: Scene, asked: Accuracy, least: int = 0) -> Choice:
    """Choice with the fewest coordinates whose error is below what is asked for, or the best.

    The error is below by MARGIN.

    It holds for loads up to a multiple of the scene's, or for these alone where larger ones have no
    unique motion, or where nothing is within what is asked for under them. least: number of
    coordinates that it has at least.
    """
    with Progress(scene.name) as progress:
        for reach in reaches(scene):
            trial = Trial(scene, asked.share, reach, progress)
            is_last = reach == 1.0
            if trial.left_out and not is_last:
                continue
            choice = best_choice(trial, asked, progress, least)
            if choice.error <= asked.share or is_last:
                break
    return choice


def best_choice(trial: Trial, asked: Accuracy, progress: Progress, least: int = 0) -> Choice:
    """Choice with the fewest coordinates that a trial finds near enough, or the best.

    It has `least` coordinates or more.
    """
    while True:
        inputs = len(trial.tests)
        choice = _first_near(trial, asked, progress, least)
        # an input that turned out to be not unique may have ruled out a choice before
        if len(trial.tests) == inputs:
            return _with_inputs(choice, trial)


def _first_near(trial: Trial, asked: Accuracy, progress: Progress, least: int) -> Choice:
    settled = settle(trial, asked)
    if not trial.tests:
        return settled
    tables = []
    for table in strain_tables(trial.scene, known_fields(trial.scene), least):
        tables.append(table)
        choice = judged(trial, settled, table, is_bounded=True)
        progress.candidate()
        if choice is not None and np.isfinite(choice.error):
            return choice

    # nothing is near enough: the best of those with the most coordinates
    best = settled
    for table in tables[-RICHEST:]:
        choice = judged(trial, settled, table, is_bounded=False)
        if choice is not None and choice.error < best.error:
            best = choice
    return best


def judged(
    trial: Trial, settled: Choice, strain: dict[str, Any], is_bounded: bool
) -> Choice | None:
    """Choice with a strain table and its error, see `Trial.distance`.

    None: there are no independent coordinates.
    """
    try:
        choice = settled.with_strain(trial.scene, strain)
        model = trial.model(choice)
    except ConfigurationError:
        return None
    error = trial.distance(model, is_bounded)
    return choice._replace(
        coordinates=model.coordinate_count, error=error / rod_length(trial.scene)
    )


def _with_inputs(choice: Choice, trial: Trial) -> Choice:
    """The choice with what it was tried on."""
    largest = trial.cases[GREATEST if len(trial.cases) > 1 else OWN]
    return choice._replace(
        missing=trial.missing,
        not_unique=trial.not_unique,
        inputs=trial.inputs,
        loads=largest.model_dump(mode="json"),
    )
