"""What the viewer opens with: every quantity in a plot of its own, in plain units and one range for all arms."""

import numpy as np
import pytest

pytest.importorskip("rerun")
import rerun.blueprint as rrb  # noqa: E402

from soft_tendon_env.drawing.palette import styles  # noqa: E402
from soft_tendon_env.drawing.shapes import side_by_side  # noqa: E402
from soft_tendon_env.recording.rerun_layout import DrawnArm, layout  # noqa: E402

SERIES = {
    "tension": ["tension 0", "tension 1", "tension 2"],
    "action": ["action 0", "action 1", "action 2"],
    "error": ["position_error", "angle_error"],
    "reward": ["reward", "reward_position"],
    "other": ["diverged"],
}


@pytest.fixture
def arms(model):
    """arms(number): arms of one second each."""

    def make(number, series=SERIES):
        drawn = styles(f"arm {k}" for k in range(number))
        places = [np.array(side_by_side(model, k)) for k in range(number)]
        return {
            name: DrawnArm(model, own, place, np.zeros(2), time=10**9, series=dict(series))
            for (name, own), place in zip(drawn.items(), places, strict=True)
        }

    return make


def views(part):
    if isinstance(part, rrb.Blueprint):
        part = part.root_container
    if isinstance(part, rrb.View):
        return [part]
    return [view for child in part.contents for view in views(child)]


def plots(blueprint):
    """By where their numbers come from; by their names those that choose among all."""
    return {view.name if view.origin == "/" else view.origin: view for view in views(blueprint) if view.class_identifier == "TimeSeries"}


@pytest.mark.parametrize("number", [1, 2, 4])
def test_every_error_has_a_plot_with_all_arms_and_every_arm_one_of_tensions(arms, number):
    found = plots(layout(arms(number), 3.0, live=False))
    assert {f"/plot/{error}" for error in SERIES["error"]} <= found.keys()
    for kind in ("tension", "action"):
        assert [origin for origin in found if origin.startswith(f"/{kind}/")] == [rf"/{kind}/arm\ {k}" for k in range(number)]
    assert not [origin for origin in found if origin.startswith("/error")], "metres and radians share no axis"


def vertical(view):
    axis = view.properties.get("ScalarAxis")
    return None if axis is None else axis.range.as_arrow_array().to_pylist()[0]


def test_errors_are_in_plain_units(arms):
    found = plots(layout(arms(1, {"error": ["position_error", "angle_error", "coordinate_error"]}), 3.0, live=False))
    assert [view.name for origin, view in found.items() if origin.startswith("/plot")] == ["position [mm]", "angle [deg]", "coordinate"]


def test_tensions_of_all_arms_have_one_range(arms, model):
    found = plots(layout(arms(2), 3.0, live=False))
    limits = np.array([tendon.tension_limits for tendon in model.scene.tendons])
    assert {tuple(vertical(found[rf"/tension/arm\ {k}"])) for k in (0, 1)} == {(limits.min(), limits.max())}
