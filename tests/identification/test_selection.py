"""Fewer parameters: told where held-out recordings are met as well without some."""

from types import SimpleNamespace

import numpy as np
import pytest

from soft_tendon_env.identification.fit import Fit
from soft_tendon_env.identification.selection import fewer_parameters_text

PARAMETERS = [SimpleNamespace(name=f"p{i}", bounds=(-10.0, 10.0)) for i in range(4)]


class LinearReadings:
    """Held-out readings J x - y of an arm that is linear in its parameters."""

    def __init__(self, jacobian, measured):
        self.jacobian = jacobian
        self.measured = measured
        self.plants = SimpleNamespace(parameters=PARAMETERS)
        self.trials = []

    def errors(self, x):
        self.trials.append(x)
        residual = self.jacobian @ x - self.measured
        return {str(i): abs(value) for i, value in enumerate(residual)}


def linear(truth, held_out_truth, noise, seed=0):
    """Least squares of 12 readings, its mean error, and held-out readings of another truth."""
    random = np.random.default_rng(seed)
    J = random.normal(size=(12, 4))
    y = J @ truth + noise * random.normal(size=12)
    x = np.linalg.lstsq(J, y, rcond=None)[0]
    residual = J @ x - y
    sigma = np.sqrt((residual**2).sum() / 8)
    estimate = Fit(x, residual, J, sigma, np.zeros(4), converged=True)
    J_judge = random.normal(size=(50, 4))
    judge = LinearReadings(J_judge, J_judge @ held_out_truth)
    return estimate, float(np.abs(residual).mean()), judge


def test_parameters_that_serve_the_fit_alone_are_named():
    truth = np.array([3.0, 0.02, -2.0, 0.01])
    estimate, fit_error, judge = linear(truth, [3.0, -0.4, -2.0, -0.4], 0.05)
    text = fewer_parameters_text(estimate, fit_error, judge)
    assert text.startswith("4 parameters judge no better than 2: ")
    assert "without p1, p3; those of the fit" in text
    assert "or record more" in text
    # the parameters that stay are those of a fit without the others
    alone = np.linalg.lstsq(
        estimate.jacobian[:, [0, 2]], estimate.jacobian @ estimate.x - estimate.residual, rcond=None
    )[0]
    np.testing.assert_allclose(judge.trials[-1][[0, 2]], alone, rtol=1e-9)
    np.testing.assert_allclose(judge.trials[-1][[1, 3]], 0.0, atol=1e-12)


def test_parameters_that_held_out_readings_call_for_are_kept():
    truth = np.array([3.0, 1.0, -2.0, 1.5])
    estimate, fit_error, judge = linear(truth, truth, 0.05)
    judge.measured = judge.measured + 0.2  # far off, and no parameter makes it worse
    assert fewer_parameters_text(estimate, fit_error, judge) is None
    assert len(judge.trials) == 5  # all, and four smaller sets


def test_nothing_is_tried_where_held_out_readings_are_met_as_well_as_those_of_the_fit():
    truth = np.array([3.0, 0.0, -2.0, 0.0])
    estimate, _, judge = linear(truth, truth, 0.05)
    held_out_error = np.mean([*judge.errors(estimate.x).values()])
    assert fewer_parameters_text(estimate, held_out_error / 1.2, judge) is None
    assert len(judge.trials) == 2
    assert fewer_parameters_text(estimate, held_out_error / 1.3, judge) is not None


def test_priors_pull_the_parameters_that_stay():
    truth = np.array([3.0, 0.1, -2.0, 0.1])
    estimate, fit_error, judge = linear(truth, [3.0, -1, -2, -1], 0.05)
    prior = np.array([0.0, 0.0, 1e9, 0.0])  # that keeps the third where it is
    fewer_parameters_text(estimate._replace(prior=prior), fit_error, judge)
    assert judge.trials[-1][2] == pytest.approx(estimate.x[2], abs=1e-6)
