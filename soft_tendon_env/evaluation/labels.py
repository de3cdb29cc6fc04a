"""Labels of points in a picture, none over another or over a point."""

from collections.abc import Iterable
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

AWAY = 4.0  # [points] from a point to its name
MARK = 3.0  # [points] that a point itself takes to every side
SIZE = 8


class Point(NamedTuple):
    """In the units of the axes."""

    x: float
    y: float
    name: str


def write_names(axes: Axes, points: Iterable[Point]) -> list[Annotation]:
    """Write the names, from the lowest point upwards, each as low as those beneath leave room; a line leads to it where it is away.

    Call it last: it takes the limits and the layout as they are.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None, "axes of a picture have one"
    figure.canvas.draw()  # lays out
    inside, per_point, texts = axes.get_window_extent(), figure.dpi / 72.0, []
    upwards = sorted(points, key=lambda point: (point.y, point.x))
    places = [axes.transData.transform(point[:2]) for point in upwards]
    taken = [Bbox([place - MARK * per_point, place + MARK * per_point]) for place in places]
    for point in upwards:
        text = axes.annotate(point.name, point[:2], (AWAY, AWAY), textcoords="offset points", fontsize=SIZE)
        text.set_in_layout(False)
        if text.get_window_extent().x1 > inside.x1:
            text.set(ha="right", position=(-AWAY, AWAY))
        up = AWAY
        while hit := [box for box in taken if box.overlaps(text.get_window_extent())]:
            up += (max(box.y1 for box in hit) - text.get_window_extent().y0) / per_point + 0.5
            text.set_position((text.get_position()[0], up))
        if up > AWAY:
            axes.annotate("", point[:2], text.get_position(), textcoords="offset points", arrowprops={"arrowstyle": "-", "lw": 0.4})
        taken.append(text.get_window_extent())
        texts.append(text)
    return texts
