"""Saved states and the tensions of an input: what is no state or no table is refused by name."""

import io

import numpy as np
import pytest

from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.state import State


@pytest.fixture
def model(build):
    return build("three_tendon", {"quadrature.intervals": 2})


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def single_array():
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


BROKEN = {
    "empty": lambda good: b"",
    "text": lambda good: b"no archive",
    "cut": lambda good: good[: len(good) // 2],
    "changed": lambda good: good.replace(b"NUMPY", b"NUMPX"),
    "one array": lambda good: single_array(),
    "other arrays": lambda good: archive(q=np.zeros(3)),
    "two times": lambda good: archive(time=[0.0, 1.0], q=np.zeros(3), q_dot=np.zeros(3), strain=np.zeros(3), step=0.1),
}


@pytest.mark.parametrize("how", BROKEN)
def test_files_that_hold_no_state_are_refused_by_name(how, model, tmp_path):
    path = tmp_path / "state.npz"
    Simulation(model).state.save(path)
    path.write_bytes(BROKEN[how](path.read_bytes()))
    with pytest.raises(ValueError, match=r"state\.npz holds no state that State\.save wrote: "):
        State.load(path)


def test_a_saved_state_is_read_back(model, tmp_path):
    state = Simulation(model).reset([0.1, 0.2, 0.3], [1.0, 0.0, -1.0])
    state.save(tmp_path / "state.npz")
    again = State.load(tmp_path / "state.npz")
    assert (again.time, again.step) == (state.time, state.step)
    for name in ("q", "q_dot", "strain"):
        np.testing.assert_array_equal(getattr(again, name), getattr(state, name))


def test_a_table_with_rows_of_different_lengths_is_refused_by_name(model):
    with pytest.raises(ValueError, match=r"^command should have shape \(2, 3\), but its rows are not alike$"):
        simulate(model, [[0.0, 0.0, 0.0], [0.0]], 0.2, 0.1)
