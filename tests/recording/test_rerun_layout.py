"""The viewer opens with every quantity in a plot of its own, in plain units and one range for all arms."""

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


def arms_of(model, number):
    """Arms of one second each, side by side."""
    drawn = styles(f"arm {k}" for k in range(number))
    return {
        name: DrawnArm(model, style, np.array(side_by_side(model, k)), np.zeros(2), time=10**9, series=dict(SERIES))
        for k, (name, style) in enumerate(drawn.items())
    }


def views(part):
    if isinstance(part, rrb.Blueprint):
        part = part.root_container
    if isinstance(part, rrb.View):
        return [part]
    return [view for child in part.contents for view in views(child)]


def plots(blueprint):
    """By where their numbers come from; by their names those that choose among all."""
    return {view.name if view.origin == "/" else view.origin: view for view in views(blueprint) if view.class_identifier == "TimeSeries"}


@pytest.mark.parametrize("number", [1, 4])
def test_every_error_has_a_plot_with_all_arms_and_every_arm_one_of_tensions_in_one_range(model, number):
    found = plots(layout(arms_of(model, number), 3.0, live=False))
    assert {f"/plot/{error}": found[f"/plot/{error}"].name for error in SERIES["error"]} == {
        "/plot/position_error": f"position [mm], up to {20.0 * model.length:.3g}",
        "/plot/angle_error": "angle [deg], up to 10",
    }
    ranges = [found[f"/plot/{error}"].properties["ScalarAxis"].range.as_arrow_array().to_pylist()[0] for error in SERIES["error"]]
    assert np.allclose(ranges, [[0.0, 20.0 * model.length], [0.0, 10.0]])
    for kind in ("tension", "action"):
        assert [origin for origin in found if origin.startswith(f"/{kind}/")] == [rf"/{kind}/arm\ {k}" for k in range(number)]
    assert not [origin for origin in found if origin.startswith("/error")], "metres and radians share no axis"
    axes = [found[rf"/tension/arm\ {k}"].properties["ScalarAxis"] for k in range(number)]
    limits = np.array([tendon.tension_limits for tendon in model.scene.tendons])
    assert {tuple(axis.range.as_arrow_array().to_pylist()[0]) for axis in axes} == {(limits.min(), limits.max())}
