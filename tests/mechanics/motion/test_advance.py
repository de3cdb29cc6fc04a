"""Steps that follow each other: those that are refused, those that follow a tolerance, and what is
kept of them."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.advance import (
    Control,
    Record,
    Scheme,
    advance,
    tip_pose,
)
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import INACCURATE, OK
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

H = 0.02  # [s]
TENSION = np.array([2.0, 0.5, 1.0])
FIXED = Control(H, 1e300, False, H / 8.0)
HOPELESS = 1e-30  # [m]


@pytest.fixture(scope="module")
def model():
    modes = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}]
    strain = {"strain": {"type": "explicit", "modes": modes}}
    scene = load_scene("three_tendon").replace(strain)
    return model_on(scene, 2)


class Run:
    """Outcome of commands (rows, 3) for durations (rows,) from the straight arm at rest."""

    def __init__(self, model, control, durations, step=H, commands=None, samples=0, columns=3):
        n = model.coordinate_count
        rows = len(durations)
        if commands is None:
            commands = np.tile(TENSION, (rows, 1))
        start = np.zeros(n)
        self.motion = Motion(
            start, np.zeros(n), model.packed_strain(start), np.zeros(0), np.array([3.0])
        )
        self.scratch = make_scratch(model.arm, columns, 64)
        poses = np.tile(np.eye(4), (samples, 1, 1))
        self.record = Record(np.zeros((samples, n)), np.zeros((samples, n)), poses)
        scheme = Scheme(Extrapolated(columns, 2, True, False, 1e-12), control)
        self.progress = advance(
            model.arm,
            scheme,
            np.array(commands),
            np.array(durations),
            self.motion,
            step,
            self.scratch,
            self.record,
        )
        taken = self.scratch.taken[: self.progress.steps]
        self.lengths, self.rows = taken.T


def test_equal_steps_fill_the_time(model):
    run = Run(model, FIXED, [5.0 * H])
    assert run.progress.status == OK
    assert run.progress.row == 1
    assert run.progress.rejected == 0
    np.testing.assert_allclose(run.lengths, H)
    assert run.lengths.size == 5
    expected_clock = 3.0 + 5.0 * H
    assert run.motion.clock[0] == pytest.approx(expected_clock)
    assert run.progress.error > 0.0
    # 1 + 1 evaluations of two columns in every step
    assert run.progress.evaluations == 10
    # two rows and one of both lengths are the same motion
    halves = Run(model, FIXED, [2.0 * H, 3.0 * H])
    assert halves.progress.row == 2
    np.testing.assert_allclose(halves.motion.q, run.motion.q, rtol=1e-9, atol=1e-15)
    assert halves.progress.error == pytest.approx(run.progress.error)
    assert halves.progress.evaluations == 10


def test_steps_that_are_refused_are_halved_to_the_smallest(model):
    """Fixed ones; those that follow a tolerance shrink to a fifth. The motion stays."""
    for adaptive, lengths in ((False, [1.0, 0.5, 0.25, 0.125]), (True, [1.0, 0.2])):
        run = Run(model, FIXED._replace(tolerance=HOPELESS, adaptive=adaptive), [H])
        assert run.progress.status == INACCURATE
        assert run.progress.row == 0
        assert run.progress.rejected == len(lengths)
        assert run.progress.steps == 0
        expected_step = 0.5 * lengths[-1] * H
        assert run.progress.step == pytest.approx(expected_step, rel=0.7)
        assert run.progress.step < H / 8.0
        np.testing.assert_array_equal(run.motion.q, 0.0)
        assert run.motion.clock[0] == 3.0
        # a column more in each, as long as there is hope
        assert run.progress.evaluations >= 2 * len(lengths)


def test_rows_behind_one_that_fails_are_not_taken(model):
    commands = [TENSION, np.array([1e9, 0.0, 0.0]), TENSION]
    control = FIXED._replace(tolerance=1.0)
    run = Run(model, control, [H, H, H], commands=commands)
    assert run.progress.status != OK
    assert run.progress.row == 1
    assert run.motion.clock[0] == pytest.approx(3.0 + H)
    first = Run(model, control, [H])
    np.testing.assert_array_equal(run.motion.q, first.motion.q)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-9])
def test_steps_that_follow_a_tolerance_err_less(model, tolerance):
    """In each of them, by as many columns and as short steps as that takes."""
    control = Control(H, tolerance, True, 1e-6 * H)
    run = Run(model, control, [10.0 * H], columns=5)
    assert run.progress.status == OK
    assert run.lengths.sum() == pytest.approx(10.0 * H)
    assert run.lengths.max() <= H * (1.0 + 1e-9)
    assert (run.lengths.min() < H) == (tolerance < 1e-6)
    assert set(run.rows) <= {2.0, 3.0, 4.0, 5.0}
    assert run.progress.error <= tolerance * run.lengths.size
    exact = Run(model, Control(H, 1e-12, True, 1e-6 * H), [10.0 * H], columns=6)
    tips = []
    for end in (run, exact):
        pose = np.eye(4)
        end.scratch.work.kinematics.base[:] = 9.0
        tip_pose(model.arm, end.motion, end.scratch.work, pose)
        expected_pose = model.tip_pose(end.motion.q)
        np.testing.assert_allclose(pose, expected_pose, atol=1e-9)
        tips.append(pose[:3, 3])
    off = np.linalg.norm(tips[0] - tips[1])
    # the tip moves two to three times as far as the rod on the average
    assert 0.0 < off < 3.0 * run.progress.error


def test_a_step_that_an_end_cuts_says_nothing_against_longer_ones(model):
    """They were planned before; none is longer than the longest."""
    shortest = 1e-6 * H
    control = Control(H, 1.0, True, shortest)
    planned = 0.7 * H
    end = 0.05 * H
    cut = Run(model, control, [end], step=planned)
    np.testing.assert_allclose(cut.lengths, end)
    assert cut.progress.step == pytest.approx(planned)
    long = 0.6 * H
    grown = Run(model, control, [long], step=long)
    assert grown.progress.step == H
    short = 0.1 * H
    slow = Run(model, control, [short], step=short)
    at_most_fourfold = 4.0 * short
    assert slow.progress.step == pytest.approx(at_most_fourfold)
    # fixed steps are the longest again in every row
    fixed = Run(model, FIXED, [2.0 * H], step=short)
    np.testing.assert_allclose(fixed.lengths, H)


def test_samples_are_evenly_among_the_rows(model):
    commands = [share * TENSION for share in (1.0, 0.5, 0.2, 1.5)]
    durations = [H, H, H, H]
    record = Run(model, FIXED, durations, commands=commands, samples=2).record
    rows_before_sample = (2, 4)
    for sample, rows in enumerate(rows_before_sample):
        shorter = Run(model, FIXED, durations[:rows], commands=commands[:rows])
        motion = shorter.motion
        pose = model.tip_pose(motion.q)
        np.testing.assert_array_equal(record.q[sample], motion.q)
        np.testing.assert_array_equal(record.q_dot[sample], motion.q_dot)
        np.testing.assert_allclose(record.tip_pose[sample], pose, atol=1e-9)
