"""Converged reference motions of a Cosserat rod, with an error bar.

They are refined until the arm's tip no longer moves.

Basis, quadrature and time steps are refined together: what a motion changes by from one level to
the next, with the tolerance of its time steps, which may err alike at both, bounds the finer one's
error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from soft_tendon_env.accuracy.input_motions import HOLD, slack_tensions
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.load_continuation import BUCKLES
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.reference_model import LEVELS, Level, reference_model, rest_near
from soft_tendon_env.model.simulation import (
    NoEquilibriumError,
    Simulation,
    SimulationDiverged,
    Trajectory,
    simulate,
)
from soft_tendon_env.model.state import State
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import LEAST_TOLERANCE, Scene, rod_length
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

STEPS = (5e-2, 1e-2, 2e-3)
"""Tolerance of time steps at each level, as a share of that of the motions; the last one holds for
the levels that follow."""

PIECE = 5
"""Rows of commands of a piece of a motion, after which it may end."""

WORK_SHARES = (0.15, 0.35, 0.5)
"""Shares of a motion's most work that its levels may take; the last one holds for those that
follow. The finer a level the more evaluations of more coordinates it has."""

CONVERGING = 1.0 / 3.0
"""Ratio of the changes from level to level below which these converge geometrically."""

LARGEST_RATIO = 0.9
"""Largest ratio that a geometric series is taken to have: a bound of nine times the change."""

SAFETY = 2.0
"""Factor of what a geometric series says is left of a motion's error, since the next ratio may be
larger."""

REST_ROWS = 10
"""Rows of a motion that take as long as an equilibrium, as measured on
benchmarks/own_arms.py: for the time to go alone."""

FINEST_STEPS = 10.0
"""Least tolerance of time steps, in units of the least that the integrator takes."""


class Reference(NamedTuple):
    """Motions and equilibria of full physics."""

    # (rows + 1, 3) [m] for every input, the tip every HOLD, the start first; None: there is no such
    # motion
    tips: tuple[Array | None, ...]
    tip_errors: tuple[float, ...]  # [m], bounds of the errors of these
    level: Level


def step_tolerance(scene: Scene, level: Level, tolerance: float) -> float:
    """Tolerance [m] of the time steps at a level of the reference.

    It is for motions with this tolerance [m].
    """
    last = len(STEPS) - 1
    depth = min(LEVELS.index(level), last)
    finest = FINEST_STEPS * LEAST_TOLERANCE * rod_length(scene)
    return max(STEPS[depth] * tolerance, finest)


def start_at_rest(model: Model) -> State | None:
    """State of a model at rest with slack tendons, where motions begin; None: it rests nowhere."""
    try:
        return Simulation(model).reset_at_rest(slack_tensions(model.scene))
    except (StrainLimitError, NoEquilibriumError):
        return None


def trajectory(model: Model, commands: Array, start: State | None = None) -> Trajectory | None:
    """Motion every HOLD from rest, slack, under commands (rows, n_a) each held for HOLD.

    None where there is no such motion or rest.

    start: where it begins, if `start_at_rest` is known.
    """
    if start is None:
        beginning = start_at_rest(model)
    else:
        beginning = start
    if beginning is None:
        return None
    try:
        duration = HOLD * len(commands)
        return simulate(model, commands, duration, HOLD, beginning)
    except (SimulationDiverged, StrainLimitError):
        return None


def pieces(model: Model, commands: Array, start: State | None) -> Iterator[Trajectory]:
    """Motion in pieces of PIECE rows each, to its end or to where there is none.

    start: where it begins; None: there is no such place, and no piece.
    """
    state = start
    for begin in range(0, len(commands), PIECE):
        rows = commands[begin : begin + PIECE]
        if state is None:
            motion = None
        else:
            motion = trajectory(model, rows, state)
        if motion is None:
            return
        yield motion
        state = motion.final  # a state continues bit for bit


def continued(tips: Array | None, piece: Trajectory) -> Array:
    """Positions of the tip (samples, 3) [m] with those of the next piece of its motion."""
    positions = piece.tip_pose[:, :3, 3]
    # a piece begins with the last sample of the one before
    if tips is None:
        return positions
    return np.concatenate([tips, positions[1:]])


def tip_path(model: Model, commands: Array, start: State | None = None) -> Array | None:
    """Positions of the tip (rows + 1, 3) [m] in a `trajectory`, or (1, 3) at rest.

    At rest they are tensions (n_a,) [N] in place of commands; None where there is none.
    """
    if commands.ndim == 1:
        rest = static_equilibrium(model, commands)
        if not rest.converged:
            return None
        return rest.tip_pose[None, :3, 3]
    motion = trajectory(model, commands, start)
    if motion is None:
        return None
    return motion.tip_pose[:, :3, 3]


def distance(path: Array | None, reference: Array | None) -> float:
    """Largest distance [m] of the tip from a reference (samples, 3).

    It is inf where the model, nan where the reference has no such motion.
    """
    if reference is None:
        return np.nan
    if path is None:
        return np.inf
    distances = np.linalg.norm(path - reference, axis=1)
    return float(distances.max())


class Ladder:
    """Models of full physics of one scene, each finer than the one before, made when first used."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        """tolerance: of motions [m]."""
        self.scene = scene
        self.tolerance = tolerance
        self._rungs: list[Rung] = []

    def rung(self, depth: int) -> Rung:
        """Full physics at the level LEVELS[depth]."""
        while len(self._rungs) <= depth:
            # the next one starts its equilibria from those of the last
            count = len(self._rungs)
            coarser = None
            if count:
                coarser = self._rungs[-1]
            level = LEVELS[count]
            steps = step_tolerance(self.scene, level, self.tolerance)
            model = reference_model(self.scene, level, steps)
            rung = Rung(model, steps, coarser)
            self._rungs.append(rung)
        return self._rungs[depth]

    @cached_property
    def buckles(self) -> bool:
        """Whether the slack arm falls over to one of several sides, at the first level.

        Where its motions begin is then not unique.
        """
        first = self.rung(0)
        if first.slack_rest is not None:
            return False
        slack = slack_tensions(self.scene)
        end = static_equilibrium(first.model, slack)
        return end.reason.endswith(BUCKLES)


class Rung:
    """Full physics at one level."""

    def __init__(self, model: Model, steps: float, coarser: Rung | None) -> None:
        self.model = model
        self.steps = steps  # [m], tolerance of time steps
        self.coarser = coarser

    @cached_property
    def slack_rest(self) -> Array | None:
        """Coordinates (n,) of a slowly loaded arm with slack tendons; None: it falls over first."""
        if self.coarser is None:
            coarse = None
        else:
            coarse = self.coarser.slack_rest
        slack = slack_tensions(self.model.scene)
        return self.rest(slack, coarse)

    @cached_property
    def start(self) -> State | None:
        """State at rest with slack tendons; None: there is none."""
        if self.slack_rest is None:
            # not from the coarser level, which would agree wherever it fell
            return start_at_rest(self.model)
        slack = slack_tensions(self.model.scene)
        simulation = Simulation(self.model)
        return simulation.reset(self.slack_rest, tension=slack)

    @cached_property
    def _projection(self) -> Array:
        """Pseudo-inverse (n, points 6) of the fields: coordinates whose strain is nearest."""
        count = self.model.coordinate_count
        packed = make_workspace(self.model.arm).strain.Phi
        packed = packed.reshape(count, -1)
        fields = self.model.grid.unpacked(packed)
        fields = fields.reshape(count, -1)
        inverse = np.linalg.pinv(fields.T)
        return np.asarray(inverse)

    def nearest(self, coarse: Array) -> Array:
        """Coordinates (n,) whose strain is nearest to that of the coarser level's coordinates."""
        assert self.coarser is not None
        grid = self.model.grid
        places = grid.points[grid.real]
        strain, _ = self.coarser.model.strain_at(coarse, places.ravel())
        # fields make what differs from the strain of the stress-free rod
        rod = self.model.arm.rod
        reference = grid.unpacked(rod.reference_strain)
        change = (strain - reference).ravel()
        return np.asarray(self._projection @ change)

    def rest(self, tensions: Array, coarse: Array | None) -> Array | None:
        """Coordinates (n,) at rest under tensions (n_a,); None: the arm rests nowhere.

        coarse: coordinates of the coarser level there, from which Newton's method starts. It takes
        one or two linearisations, where the path from the unloaded arm takes ten.
        """
        if coarse is None:
            equilibrium = static_equilibrium(self.model, tensions)
            if not equilibrium.converged:
                return None
            return equilibrium.q
        guess = self.nearest(coarse)
        return rest_near(self.model, guess, tensions, 1.0, stable=True)


class ReferenceMotion:
    """Motion or equilibrium of full physics under one input, refined level by level."""

    def __init__(
        self,
        ladder: Ladder,
        commands: Array,
        most_work: float = np.inf,
        lost: float = np.inf,
    ) -> None:
        """commands: (rows, n_a), each row held for HOLD, or tensions (n_a,) [N] at rest.

        most_work: evaluations times coordinates squared, at which a motion ends. lost: distance [m]
        of levels, at which it does too.
        """
        self.ladder = ladder
        self.commands = commands
        self.most_work = most_work
        self.lost = lost
        # (samples, 3) [m], the start first, to the end or as far as the motion is known; None: full
        # physics has no such motion
        self.tips: Array | None = None
        self.errors = np.full(1, np.inf)  # (samples,) [m], bounds of the tips' errors up to there
        self.depth = 0  # levels that were computed
        self._change: Array | None = None  # (samples,) [m] of the tips by the last level
        self._rows = len(commands)  # that the next level is computed for at most
        self._q: Array | None = None  # at the last level, of an equilibrium

    @property
    def is_equilibrium(self) -> bool:
        """Whether it is one, and no motion."""
        return self.commands.ndim == 1

    @property
    def is_whole(self) -> bool:
        """Whether the motion is known to its end."""
        if self.is_equilibrium:
            samples = 1
        else:
            samples = len(self.commands) + 1
        return self.tips is not None and len(self.tips) == samples

    @property
    def error(self) -> float:
        """Bound of the tips' error [m]; inf where the motion is not known to its end."""
        if self.is_whole:
            return float(self.errors[-1])
        return np.inf

    def rows_within(self, error: float) -> int:
        """Rows of commands through which the tips' error is at most so large [m]."""
        is_known = self.errors <= error
        samples = int(np.count_nonzero(is_known))
        return max(samples - 1, 0)

    @property
    def next_size(self) -> float:
        """Expected cost of the next level, see `size_at`."""
        return self.size_at(self.depth)

    def size_at(self, depth: int) -> float:
        """Expected cost of a level, in units that are the same for all inputs."""
        if self.is_equilibrium:
            rows = REST_ROWS
        else:
            rows = len(self.commands)
        rung = self.ladder.rung(depth)
        return rows * rung.model.coordinate_count**2.0

    def refine(self) -> None:
        """Computes the next level; the change bounds the error."""
        rung = self.ladder.rung(self.depth)
        if self.is_equilibrium:
            self._refine_rest(rung)
        else:
            self._refine_motion(rung)
        self.depth += 1

    def _refine_rest(self, rung: Rung) -> None:
        before = self.tips
        self._q = rung.rest(self.commands, self._q)
        if self._q is None:
            self.tips = None
        else:
            pose = rung.model.tip_pose(self._q)
            self.tips = pose[None, :3, 3]
        self.errors = np.full(1, np.inf)
        # the first level has nothing that it could be compared with
        if before is not None:
            self.errors[0] = distance(self.tips, before)

    def _refine_motion(self, rung: Rung) -> None:
        coarse = self.tips
        coarse_errors = self.errors
        tips = self._motion(rung)
        if tips is None:
            self.tips = None
            self.errors = np.full(1, np.inf)
            return
        # the first level has nothing that it could be compared with
        errors = np.full(len(tips), np.inf)
        if coarse is not None:
            both = min(len(tips), len(coarse))
            finer = tips[:both]
            coarser = coarse[:both]
            differences = finer - coarser
            apart = np.linalg.norm(differences, axis=1)
            change = np.maximum.accumulate(apart)
            # time steps may err alike at both levels
            remaining = remaining_error(change, self._change)
            errors[:both] = remaining + rung.steps
            self._change = change
        has_no_work_left = coarse is not None and len(tips) == self._rows + 1 < len(coarse)
        if coarse is not None and has_no_work_left and errors[-1] <= self.lost:
            # what follows is known from the level before
            later = slice(len(tips), None)
            parts = [tips, coarse[later]]
            tips = np.concatenate(parts)
            parts_of_errors = [errors, coarse_errors[later]]
            errors = np.concatenate(parts_of_errors)
            errors = np.maximum.accumulate(errors)
        self.tips = tips
        self.errors = errors

    def _motion(self, rung: Rung) -> Array | None:
        """Positions of the tip (samples, 3) [m] at a level; None: there is no such motion.

        They end where its work is done, where it has strayed from the coarser level, or where full
        physics has no motion any more.
        """
        last_share = len(WORK_SHARES) - 1
        share = WORK_SHARES[min(self.depth, last_share)]
        work_left = share * self.most_work
        tips: Array | None = None
        commands = self.commands[: self._rows]
        for piece in pieces(rung.model, commands, rung.start):
            tips = continued(tips, piece)
            cost = rung.model.coordinate_count**2.0
            work_left -= piece.evaluations * cost
            if work_left <= 0.0 or self._has_strayed(tips):
                self._rows = len(tips) - 1  # nothing can be compared with what follows
                break
        return tips

    def _has_strayed(self, tips: Array) -> bool:
        """Whether the coarser level is too far away at the last of these samples of the tip."""
        if self.tips is None or len(tips) > len(self.tips):
            return False
        last = len(tips) - 1
        known = self.tips[last]
        difference = tips[last] - known
        distance = float(np.linalg.norm(difference))
        return distance > self.lost


def remaining_error(change: Array, before: Array | None) -> Array:
    """Bound (samples,) [m] of a motion's error after a change (samples,) [m] by the last level.

    It is the change, or what is left of a geometric series: less, and times SAFETY, where the
    change is a small part of the one before, and more where it is nearly as large.
    """
    if before is None:
        return change
    bound = change.copy()
    samples = min(len(change), len(before))
    last = change[:samples]
    smallest = np.finfo(float).tiny
    known_before = before[:samples]
    change_before = np.maximum(known_before, smallest)
    ratio = np.minimum(last / change_before, LARGEST_RATIO)
    left = last * ratio / (1.0 - ratio)
    larger = np.maximum(last, left)
    safe = SAFETY * left
    bound[:samples] = np.where(ratio < CONVERGING, safe, larger)
    return np.maximum.accumulate(bound)


def refine_once(
    motions: Sequence[ReferenceMotion],
    label: str | None,
    done: Callable[[int, None], None] | None = None,
) -> None:
    """Refines motions by a level, in threads; label: of the progress bar, None: there is none.

    done: is told of every motion as soon as it is there, with its place.
    """
    for motion in motions:  # what threads share is made before them
        rung = motion.ladder.rung(motion.depth)
        if not motion.is_equilibrium:
            _ = rung.start
    run_all(
        ReferenceMotion.refine,
        motions,
        processors(),
        label,
        unit="motion",
        threads=True,
        done=done,
    )


def reference_motions(
    scene: Scene, inputs: Sequence[Array], tolerance: float, most: int = len(LEVELS)
) -> Reference:
    """Converged reference motions or equilibria under inputs.

    Inputs are (rows, n_a) [N], each row held for HOLD, of equilibria (n_a,). Each is refined until
    its error is below `tolerance` [m], or to the finest of the first `most` of LEVELS. The level is
    that of the last to be refined.
    """
    ladder = Ladder(scene, tolerance)
    motions = [ReferenceMotion(ladder, commands) for commands in inputs]
    unsettled = list(motions)
    for depth in range(most):
        count = ladder.rung(depth).model.coordinate_count
        title = f"{scene.name}: full physics, {count} coordinates"
        refine_once(unsettled, title)
        level = LEVELS[depth]
        unsettled = [motion for motion in unsettled if motion.error > tolerance]
        # what full physics has not at this level it has at no finer one, where others are settled
        is_unknown = (not motion.is_whole for motion in unsettled)
        is_hopeless = all(is_unknown)
        if is_hopeless and len(unsettled) < len(motions):
            break
    whole_tips = (motion.tips if motion.is_whole else None for motion in motions)
    tips = tuple(whole_tips)
    errors = tuple(motion.error for motion in motions)
    return Reference(tips, errors, level)
