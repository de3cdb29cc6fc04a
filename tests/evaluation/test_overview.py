"""The overview picture shows what the episodes hold: paths, shapes, errors and numbers of known
rollouts."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.image import imread

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation import overview
from soft_tendon_env.evaluation.overview import Overview
from soft_tendon_env.recording.rollout import Rollout

PERIOD = 0.02  # [s]
SAMPLES = 21
RADIUS = 0.1  # of the target's circle [m]
OFF = {"tracking": 0.0, "agent": 1e-3, "paper": 0.2}  # of the tip's circle's radius [m]


def circle(radius):
    """Poses (SAMPLES, 4, 4) along a circle about the base's x axis."""
    angle = np.linspace(0.0, 2.0 * np.pi, SAMPLES)
    poses = np.tile(np.eye(4), (SAMPLES, 1, 1))
    poses[:, 1, 3] = radius * np.cos(angle)
    poses[:, 2, 3] = radius * np.sin(angle)
    return poses


@pytest.fixture
def known(build):
    """An Overview of three policies whose tips run on circles that are OFF the target's; the
    straight arm stands still."""
    model = build("three_tendon")
    straight = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (SAMPLES, 1, 1))
    rollouts = {
        name: Rollout(
            model,
            PERIOD,
            straight,
            tension=np.zeros((SAMPLES, model.tendon_count)),
            tip_pose=circle(RADIUS + off),
            target_pose=circle(RADIUS),
            scalars={"position_error": np.full(SAMPLES, off) + 1e-5},
        )
        for name, off in OFF.items()
    }
    numbers = {name: {"circle\n[mm]": f"{1e3 * off:g}"} for name, off in OFF.items()}
    return Overview("three policies", rollouts, "agent", "position_error", numbers)


@pytest.fixture
def axes():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def labelled(axes):
    """Points (m, 2) of the lines that have a label, by it."""
    return {
        line.get_label(): line.get_xydata()
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def test_paths_are_those_of_tips_and_target_across_the_base(known, axes):
    overview.draw_paths(axes, known, styles(OFF))
    paths = labelled(axes)
    assert [*paths] == ["target", *OFF]
    for name, off in [("target", 0.0), *OFF.items()]:
        expected_paths = circle(RADIUS + off)[:, 1:3, 3]
        np.testing.assert_allclose(paths[name], expected_paths, atol=1e-12)
    left, right = axes.get_xlim()
    assert left < -RADIUS, "a path far off is cut"
    assert RADIUS < right < RADIUS + OFF["paper"], "a path far off is cut"


def test_lines_get_thinner_one_upon_the_other_and_lost_ones_are_thinnest(known):
    width = overview.line_widths(known)
    assert width["tracking"] > width["agent"] > width["paper"]
    assert width["paper"] == overview.LOST_WIDTH


def test_the_arm_is_drawn_from_its_first_sample_to_its_last(known, axes):
    length = known.rollouts["agent"].model.length
    backbones = overview.backbones_on_the_way(known.rollouts["agent"])
    assert len(backbones) == overview.SHAPES
    expected_backbones = np.tile([length, 0.0, 0.0], (len(backbones), 1))
    np.testing.assert_allclose(backbones[:, -1], expected_backbones)
    overview.draw_arm(axes, known, styles(OFF))
    rods = [line for line in axes.lines if line.get_color() == styles(OFF)["agent"].rgb]
    opacities = [line.get_alpha() for line in rods]
    assert len(rods) == overview.SHAPES
    assert opacities == sorted(opacities)


def test_errors_over_time_are_in_millimetres_and_seconds(known, axes):
    overview.draw_errors_over_time(axes, known, styles(OFF))
    errors = labelled(axes)
    assert [*errors] == [*OFF]
    for name, off in OFF.items():
        expected_errors = PERIOD * np.arange(SAMPLES)
        np.testing.assert_allclose(errors[name][:, 0], expected_errors)
        np.testing.assert_allclose(errors[name][:, 1], 1e3 * off + 1e-2)


def test_numbers_stand_as_they_came(known, axes):
    overview.draw_numbers(axes, known.numbers, styles(OFF))
    assert {text.get_text() for text in axes.texts} == {"circle\n[mm]", *OFF, "0", "1", "200"}


def test_the_overview_has_its_headline_above_four_drawings(known, monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(overview, "save_figure", lambda figure, path: drawn.append(figure))
    overview.draw_overview(known, tmp_path / "demo.png")
    (figure,) = drawn
    assert figure.get_suptitle() == known.headline
    assert len(figure.axes) == 4
    assert all(axes.lines or axes.texts for axes in figure.axes)
    plt.close(figure)


@pytest.mark.slow  # it draws
def test_the_picture_is_upright_and_of_the_width_of_a_phone_times_three(known, tmp_path):
    overview.draw_overview(known, tmp_path / "demo.png")
    height, width = imread(tmp_path / "demo.png").shape[:2]
    assert 1000 < width < 1200
    assert 1.3 < height / width < 1.6


def test_room_around_points_is_a_share_of_their_widths(axes):
    points = np.array([[1.0, 10.0], [3.0, 14.0], [2.0, 12.0]])
    overview.show_around(axes, points, 0.25)
    np.testing.assert_allclose([axes.get_xlim(), axes.get_ylim()], [(0.5, 3.5), (9.0, 15.0)])


def test_the_dashed_line_is_where_an_episode_has_settled(known, axes):
    """A hundredth of the rod's length, in millimetres; errors differ by factors."""
    overview.draw_errors_over_time(axes, known, styles(OFF))
    length = known.rollouts["agent"].model.length
    (bound,) = [line for line in axes.lines if line.get_linestyle() == "--"]
    np.testing.assert_allclose(bound.get_ydata(), 1e3 * 0.01 * length)
    assert axes.get_yscale() == "log"


def test_rows_of_numbers_stand_below_one_another_and_end_at_the_right(known, axes):
    overview.draw_numbers(axes, known.numbers, styles(OFF))
    places = {text.get_text(): text.get_position() for text in axes.texts}
    heights = [places[name][1] for name in OFF]
    assert heights == [0, 1, 2]
    bottom, top = axes.get_ylim()
    assert bottom > 2.0
    assert top < 0.0
    for x, y in places.values():
        assert top < y < bottom
        assert 0.0 < x <= 1.0
