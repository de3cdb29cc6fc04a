"""Search for the coordinates, quadrature and time steps of an arm: the fewest that are near enough.

Candidates are judged one by one in a trial of the arm, from few coordinates to many.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from soft_tendon_env.accuracy.candidates import known_fields, strain_tables
from soft_tendon_env.accuracy.choice import Accuracy, Choice
from soft_tendon_env.accuracy.input_motions import DURATION, HOLD
from soft_tendon_env.accuracy.loads import reaches
from soft_tendon_env.accuracy.progress import Progress
from soft_tendon_env.accuracy.settling import settle, settled_steps
from soft_tendon_env.accuracy.trial import GREATEST, OWN, Trial
from soft_tendon_env.model.statics import RedundancyWarning
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError

HORIZONS = (0.1, 0.2, 0.5, 1.0, DURATION)
"""Times [s] for which an error that grows is told."""

RESETTLED = 2
"""Factor of coordinates after which steps are settled anew: a model with more of them vibrates
faster, and the same steps are less accurate. More coordinates yet would not help."""

RICHEST = 3
"""Candidates with the most coordinates, of which the best is taken where none is near enough."""


def search(scene: Scene, asked: Accuracy, least: int = 0) -> Choice:
    """Choice with the fewest coordinates whose error is below what is asked for, or the best.

    The error is below by `trial.MARGIN`.

    It holds for loads up to a multiple of the scene's, or for these alone where larger ones have no
    unique motion, or where nothing is within what is asked for under them. least: number of
    coordinates that it has at least.
    """
    with Progress(scene.name) as progress, warnings.catch_warnings():
        # of models that are tried, which nobody asked for
        warnings.simplefilter("ignore", RedundancyWarning)
        for reach in reaches(scene):
            trial = Trial(scene, asked.share, reach, progress)
            is_last = reach == 1.0
            if trial.left_out and not is_last:
                continue
            choice = best_choice(trial, asked, progress, least)
            is_within = choice.error <= asked.share
            if is_within or is_last:
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
            return _with_inputs(choice, trial, asked)


def _first_near(trial: Trial, asked: Accuracy, progress: Progress, least: int) -> Choice:
    """The first of the candidates that is near enough, or the best of the richest ones."""
    settled = settle(trial, asked)
    if not trial.tests:
        return settled
    tables = []
    fields = known_fields(trial.scene)
    coordinates = settled.coordinates  # that steps were settled with
    for table in strain_tables(trial.scene, fields, least):
        tables.append(table)
        choice = judged(trial, settled, table, is_bounded=True)
        progress.candidate()
        if choice is None:
            continue
        resettled = RESETTLED * coordinates
        has_grown = choice.coordinates >= resettled
        if has_grown and not _is_near(choice):
            coordinates = choice.coordinates
            finer = _resettled(trial, settled, choice)
            if finer.integrator != settled.integrator:
                settled = finer
                choice = judged(trial, settled, table, is_bounded=True)
        if choice is not None and _is_near(choice):
            return choice
    return _best_of(tables[-RICHEST:], trial, settled)


def _is_near(choice: Choice) -> bool:
    """Whether a choice that was judged within bounds is near enough: the others' errors are inf."""
    return bool(np.isfinite(choice.error))


def _resettled(trial: Trial, settled: Choice, choice: Choice) -> Choice:
    """The settled choice with time steps that are settled anew, with the coordinates of another."""
    finer = settled_steps(trial, choice)
    return settled._replace(integrator=finer.integrator)


def _best_of(tables: list[dict[str, Any]], trial: Trial, settled: Choice) -> Choice:
    """Choice of the strain table with the smallest error, where none is near enough."""
    best = settled
    for table in tables:
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


def _with_inputs(choice: Choice, trial: Trial, asked: Accuracy) -> Choice:
    """The choice with what it was tried on, and how its error grows where that is not within."""
    if len(trial.cases) > 1:
        case = GREATEST
    else:
        case = OWN
    largest = trial.cases[case]
    is_accurate = choice.error <= asked.share
    is_within = is_accurate and trial.seconds == DURATION
    is_known = np.isfinite(choice.error)
    if is_known and not is_within:
        bounds_in_metres = trial.growth(trial.model(choice))
        bounds = bounds_in_metres / rod_length(trial.scene)
        is_accurate_until = bounds <= asked.share
        samples = int(np.count_nonzero(is_accurate_until))
        growth = []
        for seconds in HORIZONS:
            sample = round(seconds / HOLD)
            growth.append((seconds, float(bounds[sample])))
        within = HOLD * max(samples - 1, 0)
        choice = choice._replace(seconds=within, growth=tuple(growth))
    return choice._replace(
        tensions=trial.share,
        missing=trial.missing,
        not_unique=trial.not_unique,
        inputs=trial.inputs,
        loads=largest.model_dump(mode="json"),
        reach=trial.reach,
    )
