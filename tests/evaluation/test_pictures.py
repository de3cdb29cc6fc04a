"""Pictures of errors by condition: points are interquartile means, lines their intervals, one
below the other."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation import pictures
from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.pictures import SPREAD, _draw_panel, draw_errors
from soft_tendon_env.evaluation.summaries import Standing


def standing(*errors):
    """Of errors [m], an episode each."""
    scores = []
    for seed, error in enumerate(errors):
        of_error = {"position_error": ErrorScore(error, error)}
        score = EpisodeScore(seed, 10, of_error, False, {}, 0.0, None, None, 0.001, 1.0)
        scores.append(score)
    return Standing([scores])


@pytest.fixture
def axes():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def test_policies_stand_below_one_another_in_every_condition(axes):
    """In millimetres, on a logarithmic scale; where one did not play there is nothing."""
    panel = {
        ("a", "x"): standing(0.001, 0.002, 0.003, 0.050),
        ("b", "x"): standing(0.004, 0.004),
        ("a", "y"): standing(0.005, 0.005),
    }
    _draw_panel(axes, panel, styles(["a", "b"]))
    points = {line.get_label(): line.get_xydata() for line in axes.lines}
    aside = SPREAD / 4.0
    np.testing.assert_allclose(points["a"], [[2.5, -aside], [5.0, 1.0 - aside]])
    np.testing.assert_allclose(points["b"], [[4.0, aside]])
    intervals = [path.vertices for lines in axes.collections for path in lines.get_paths()]
    mean = panel["a", "x"].mean("position_error_rms")
    expected = [[1e3 * mean.low, -aside], [1e3 * mean.high, -aside]]
    np.testing.assert_allclose(intervals[0], expected)
    borders = [line.get_ydata()[0] for line in axes.lines if line.get_label().startswith("_")]
    assert borders == [0.5]
    assert axes.get_ylim() == (1.5, -0.5)
    assert axes.get_xscale() == "log"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["x", "y"]


def test_panels_have_their_titles_and_share_a_legend(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    panels = {
        "tip": {("a", "x"): standing(0.001)},
        "state": {("a", "x"): standing(0.001), ("b", "x"): standing(0.002)},
    }
    draw_errors(panels, tmp_path / "errors.png")
    (figure,) = drawn
    assert [axes.get_title() for axes in figure.axes] == ["tip", "state"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b"]
    plt.close(figure)
