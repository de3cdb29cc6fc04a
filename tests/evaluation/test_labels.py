"""Names in pictures: each can be read."""

import itertools

import matplotlib
import numpy as np
import pytest

from soft_tendon_env.evaluation import labels

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@pytest.mark.parametrize("spread", [1.0, 0.1, 0.0], ids=["apart", "close", "one point"])
def test_no_name_lies_over_another(spread):
    rng = np.random.default_rng(0)
    figure, axes = plt.subplots(figsize=(6, 5), dpi=130, constrained_layout=True)
    points = [labels.Point(*(10.0 ** (spread * rng.normal(size=2))), f"policy_number_{i}") for i in range(12)]
    for point in points:
        axes.plot(point.x, point.y, "o")
    axes.set(xscale="log", yscale="log")
    texts = labels.write_names(axes, points)
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in texts]
    assert sorted(text.get_text() for text in texts) == sorted(point.name for point in points)
    assert not [pair for pair in itertools.combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    for place in axes.transData.transform([point[:2] for point in points]):
        assert not [box for box in boxes if box.contains(*place)]
    assert all(box.x1 <= axes.get_window_extent().x1 for box in boxes)
    plt.close(figure)
