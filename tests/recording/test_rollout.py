import dataclasses

import numpy as np
import pytest

from soft_tendon_env.recording.rollout import RolloutBuffer, scalar_columns


def refill(buffer, rollout, samples):
    for k in samples:
        record = {name: values[k] for name, values in rollout.scalars.items()}
        buffer.append(
            rollout.model.grid.packed(rollout.strain[k]),
            rollout.tension[k],
            rollout.tip_pose[k],
            rollout.target_pose[k],
            rollout.target_backbone[k],
            rollout.action[k],
            record,
        )


def assert_equal(found, wanted, part=slice(None)):
    for name in ("strain", "tension", "tip_pose", "target_pose", "target_backbone", "action"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name)[part])
    assert found.scalars.keys() == wanted.scalars.keys()
    for name, values in wanted.scalars.items():
        np.testing.assert_array_equal(found.scalars[name], values[part])


@pytest.fixture
def buffer(model):
    return lambda wanted: RolloutBuffer(model, wanted.period)


def test_a_buffer_returns_what_was_appended(rollout, buffer):
    wanted = rollout(7)
    filled = buffer(wanted)
    refill(filled, wanted, range(7))
    assert len(filled) == 7
    assert_equal(filled.rollout(), wanted)


def test_a_cleared_buffer_starts_anew_and_leaves_what_it_gave(rollout, buffer):
    wanted = rollout(6)
    filled = buffer(wanted)
    refill(filled, wanted, range(3))
    first = filled.rollout()
    filled.clear()
    refill(filled, wanted, range(3, 6))
    assert_equal(first, wanted, slice(0, 3))
    assert_equal(filled.rollout(), wanted, slice(3, 6))


def test_a_buffer_copies_arrays_that_the_environment_writes_over(rollout, buffer):
    wanted = rollout(3)
    reused = dataclasses.replace(wanted, tension=wanted.tension.copy())
    filled = buffer(wanted)
    refill(filled, reused, range(3))
    reused.tension[:] = 0.0
    assert_equal(filled.rollout(), wanted)


def test_scalars_are_numbers_and_bools_and_nan_where_missing():
    records = {"error": 1, "cause": "none"}, {"error": np.float32(0.5), "success": True}, {"success": np.False_, "array": [1.0]}
    columns = scalar_columns([*records])
    assert list(columns) == ["error", "success"]
    np.testing.assert_array_equal(columns["error"], [1.0, 0.5, np.nan])
    np.testing.assert_array_equal(columns["success"], [np.nan, 1.0, 0.0])


@pytest.mark.parametrize(
    ("name", "shape", "wanted"),
    [("strain", (7, 3), "(7, "), ("tension", (7, 2), "(7, 3)"), ("tip_pose", (6, 4, 4), "(7, 4, 4)"), ("action", (7,), "(7, any)")],
)
def test_a_rollout_names_the_array_of_wrong_shape(rollout, name, shape, wanted):
    with pytest.raises(ValueError, match=name) as raised:
        dataclasses.replace(rollout(7), **{name: np.zeros(shape)})
    assert wanted in str(raised.value) and str(shape) in str(raised.value)


def test_a_rollout_names_the_scalar_of_wrong_shape(rollout):
    with pytest.raises(ValueError, match="scalars\\['reward'\\]"):
        dataclasses.replace(rollout(7), scalars={"reward": np.zeros(6)})
