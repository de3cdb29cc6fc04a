"""Findings in residuals: ruined holds, held-out ones too, drift, and none for noise."""

import numpy as np
import pytest

from soft_tendon_env.identification.misfits import Arm, Misfit, drift_text, misfit_texts
from soft_tendon_env.identification.recordings import Recording

ARM = Arm(length=0.3, markers=("m0", "m1"), tendons=3)
NOISE = 2e-4


def misfits_of(seed, holds=12, every=4, noise=NOISE, change=None):
    """Residuals of holds with noise, every fourth of them held out; `change` of (order, residuals
    (holds, 2, 3)) ruins them."""
    random = np.random.default_rng(seed)
    commands = random.uniform(0.0, 3.0, (holds, 3))
    residual = noise * random.normal(size=(holds, 2, 3))
    if change is not None:
        change(np.arange(holds) / (holds - 1), residual)
    misfits = [
        Misfit(
            Recording(
                f"h{i}", "", commands[i : i + 1], residual[i : i + 1], 0.0, {}, "", commands, i
            ),
            residual[i : i + 1],
            held_out=bool(every) and i % every == 2,
        )
        for i in range(holds)
    ]
    # those of the fit come first, as `findings` has them
    return sorted(misfits, key=lambda misfit: misfit.held_out)


def texts_of(misfits, noise=None):
    return misfit_texts(misfits, ARM, noise)


def test_clean_recordings_have_no_findings():
    told = 0
    for seed in range(40):
        misfits = misfits_of(seed)
        told += bool(texts_of(misfits, NOISE) or drift_text(misfits))
    assert told <= 1


def shifted(hold, marker, way):
    """A change that moves a marker of one hold by way (3,) [m]."""

    def change(order, residual):
        residual[hold, marker] += way

    return change


def test_a_ruined_hold_is_named_where_it_is_held_out_too():
    for hold, kind in ((6, ", which is held out"), (5, "")):
        (text,) = texts_of(misfits_of(1, change=shifted(hold, 1, [0.0, 0.03, 0.0])))
        assert text.startswith("1 of the markers' positions stand out, above all m1 in 'h")
        assert f"'h{hold}'{kind}, 30" in text
        assert ("held-out error means nothing" in text) == bool(kind)
        assert ("bias the estimate" in text) == (not kind)


def test_positions_below_a_share_of_the_arm_do_not_stand_out():
    """Six medians of small noise are less than 1 % of 0.3 m."""
    for size, count in ((2.7e-3, 0), (3.6e-3, 1)):
        misfits = misfits_of(2, noise=1e-4, change=shifted(4, 0, [size, 0.0, 0.0]))
        assert len(texts_of(misfits)) == count
    # and of large noise six medians count
    for size, count in ((6e-3, 0), (12e-3, 1)):
        misfits = misfits_of(2, noise=8e-4, change=shifted(4, 0, [size, 0.0, 0.0]))
        assert len(texts_of(misfits)) == count


def test_held_out_holds_that_are_met_badly_are_named_with_the_worst_first():
    def change(order, residual):
        residual[[2, 6, 10], 0] += np.diag([4e-3, 6e-3, -5e-3])
        residual[[2, 6, 10], 1] += [0.0, 3.5e-3, 0.0]

    (text,) = texts_of(misfits_of(3, change=change))
    assert "Held-out recordings are off by 4.2 mm, those of the fit by 0.3" in text
    assert text.index("'h6' (m0 by 6") < text.index("'h10' (m0 by 4") < text.index("'h2' (m0 by 4")


def test_held_out_data_are_told_beside_a_fit_without_noise():
    misfits = misfits_of(3, noise=0.0, change=shifted(2, 1, [0.0, 1e-3, 0.0]))
    (text,) = texts_of(misfits)
    assert "the worst are 'h2' (m1 by 1 mm)" in text
    assert not texts_of(misfits_of(3, noise=0.0))


def drifting(way):
    def change(order, residual):
        residual += order[:, None, None] * np.asarray(way)

    return change


def jumping(order, residual):
    residual[order > 0.55] += [0.0, -6e-3, 0.0]


@pytest.mark.parametrize(
    ("change", "way"),
    [(drifting([0.0, 0.01, 0.0]), 10.0), (drifting([3e-3, 0.0, -4e-3]), 5.0), (jumping, 6.0)],
)
def test_a_drift_of_all_markers_is_told_with_its_size(change, way):
    for seed in range(3):
        text = drift_text(misfits_of(seed, change=change))
        assert "drift together over the session" in text
        assert "from 'h0' to 'h11'" in text
        size = float(text.split(" mm")[0].split("by ")[-1])
        assert size == pytest.approx(way, rel=0.13)


def test_what_is_no_drift_is_not_told_as_one():
    def one_marker(order, residual):
        residual[:, 0, 1] += 6e-3 * order
        residual[:, 1, 1] -= 6e-3 * order

    def alternating(order, residual):
        residual[::2] += 5e-3

    assert drift_text(misfits_of(1, change=one_marker)) is None
    assert drift_text(misfits_of(1, change=alternating)) is None
    assert drift_text(misfits_of(1, holds=7, every=0, change=drifting([0, 0.01, 0]))) is None


def test_residuals_above_a_known_noise_are_told():
    misfits = misfits_of(4)
    assert not texts_of(misfits, noise=NOISE / 1.3)
    (text,) = texts_of(misfits, noise=NOISE / 1.8)
    assert "where the noise is 0.111 mm: the model lacks something" in text


def test_residuals_that_follow_the_squares_of_commands_are_told():
    misfits = misfits_of(5, holds=30, every=0)
    for misfit in misfits:
        command = misfit.recording.command[0, 2]
        misfit.residual[0, :, 1] += 2e-4 * command**2
    (text,) = texts_of(misfits)
    assert text.startswith("Residuals of holds follow the commands, by ")
    size = float(text.split("by ")[1].split(" mm")[0])
    commands = np.array([misfit.recording.command[0, 2] for misfit in misfits])
    law = 1e3 * 2e-4 * commands**2  # [mm]
    mean_square = (law**2).mean()
    # a third of the coordinates have it
    expected = np.sqrt(mean_square / 3.0)
    assert size == pytest.approx(expected, rel=0.1)


def motion(residual, positions=None):
    count = len(residual)
    if positions is None:
        still = np.zeros((count, 2, 3))
    else:
        still = positions
    recording = Recording("steps", "", np.zeros((count, 3)), still, 0.01, {})
    return [Misfit(recording, residual, held_out=False)]


def test_successive_residuals_of_a_motion_that_follow_each_other_are_told():
    random = np.random.default_rng(0)
    noise = 1e-3 * random.normal(size=(60, 2, 3))
    assert not texts_of(motion(noise))
    slow = noise.copy()
    slow += 1e-3 * np.sin(np.arange(60) / 8.0)[:, None, None]
    (text,) = texts_of(motion(slow))
    assert "successive ones have 0.7" in text
    assert "viscous damping alone cannot make up for friction" in text
    assert not texts_of(motion(slow[:17]))  # 96 pairs may be chance


def test_a_sample_that_stands_out_of_a_slow_error_is_an_outlier_and_the_slow_error_is_none():
    wave = np.sin(np.arange(12) / 4.0)
    slow = 8e-3 * wave[:, None, None] * np.ones((12, 2, 3))
    assert not any("stand out" in text for text in texts_of(motion(slow)))
    slow[7, 1] += [0.0, 0.02, 0.0]
    assert any("above all m1 in 'steps'" in text for text in texts_of(motion(slow)))


def test_a_motion_that_begins_before_rest_is_told_from_half_a_percent_of_the_arm_on():
    rng = np.random.default_rng(1)
    noise = 1e-4 * rng.normal(size=(10, 2, 3))
    for way, count in ((1.2e-3, 0), (1.8e-3, 1)):
        positions = np.zeros((10, 2, 3))
        positions[1:, 1, 0] = way
        assert len(texts_of(motion(noise, positions))) == count
