"""The arm as curves in space."""

import numpy as np
import pytest

from soft_tendon_env.drawing.curves import backbones, tendon_curves


@pytest.fixture(params=["three_tendon", "paper", "helical"])
def model(request, build):
    return build(request.param, {"quadrature.intervals": 4})


def test_backbones_of_strain_fields_are_the_model_s(model, random_state):
    q = np.stack([random_state(model, seed)[0] for seed in range(3)])
    arc_length = np.linspace(0.0, model.length, 17)
    found = backbones(model, np.stack([model.strain(each)[1] for each in q]), arc_length)
    np.testing.assert_allclose(found, [model.backbone_at(each, arc_length) for each in q], atol=1e-12)


def test_tendons_run_where_the_routing_says(model, random_state):
    """As long as the model says where there are points enough, and at their offset from the backbone."""
    q, _ = random_state(model, 1)
    arc_length = np.linspace(0.0, model.length, 4001)
    backbone = backbones(model, model.strain(q)[1][None], arc_length)
    curves = tendon_curves(model, backbone, arc_length)
    assert len(curves) == model.tendon_count
    for tendon, curve, length in zip(model.scene.tendons, curves, model.tendon_lengths(q), strict=True):
        assert curve.shape[0] == 1 and curve.shape[2] == 3
        assert np.linalg.norm(np.diff(curve[0], axis=0), axis=1).sum() == pytest.approx(length, rel=2e-3)
        inside = (arc_length >= tendon.start) & (arc_length <= (tendon.end or model.length))
        local = np.einsum("mji,mj->mi", backbone[0, inside, :3, :3], curve[0] - backbone[0, inside, :3, 3])
        np.testing.assert_allclose(local[:, 0], 0.0, atol=1e-12)


def test_no_arc_length_gives_no_curve(model):
    none = np.empty(0)
    assert backbones(model, model.strain(np.zeros(model.coordinate_count))[1][None], none).shape == (1, 0, 4, 4)
