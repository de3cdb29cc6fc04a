"""A part of what `random_scenes.py` goes through: scenes that nobody chose."""

import collections

import numpy as np
import pytest
import random_scenes

import soft_tendon_env as ste
from soft_tendon_env.scene.scene import rod_length

QUICK = (*range(5), 44)  # the last one buckles


@pytest.mark.parametrize(
    "numbers",
    [QUICK, pytest.param({*range(60)} - {*QUICK}, marks=pytest.mark.slow)],
    ids=["quick", "others"],
)
def test_statics_of_random_scenes(measured, numbers):
    """60 random scenes: routings of all kinds, one to three segments, stiffness over four decades,
    gravity in any direction, payloads, dead and follower forces, moments, tensions up to the
    limits; slack ropes and columns that buckle among them. Expected: the equilibrium is the end of
    a slow loading to 1e-6 of the length, or is not converged, with the load and a reason; the tip
    is where a quadrature of three times as many intervals puts it, to the scene's tolerance, or a
    warning was given."""
    kinds = collections.Counter()
    distances = []
    quadratures = []
    for number in numbers:
        verdict = random_scenes.verdict(number)
        assert not verdict.problems, (number, verdict.problems)
        kinds[verdict.kind] += 1
        distances.append(verdict.distance)
        quadratures.append(verdict.quadrature)
    measured("converged", kinds["converged"])
    measured("ended before the full load", kinds.total() - kinds["converged"])
    measured("tip to slow loading [lengths]", np.nanmax(distances))
    measured("tip to a finer quadrature [tolerances]", np.nanmax(quadratures))
    assert kinds.total() > kinds["converged"] > 0.5 * kinds.total()


@pytest.mark.parametrize(
    "numbers",
    [{3, 5}, pytest.param({*range(30)} - {3, 5}, marks=pytest.mark.slow)],
    ids=["quick", "others"],
)
def test_a_random_scene_pushed_off_its_equilibrium_comes_back(measured, numbers):
    """Random scenes, released at 3 degrees from their equilibrium in a random direction, with five
    times their damping. Expected: where the arm converged, it comes back within ten minutes, to
    1e-5 of the length."""
    farthest = 0.0
    count = 0
    for number in numbers:
        scene, tension = random_scenes.drawn_scene(number)
        if (
            scene.strain.type != "statics_based" or len(scene.strain.strains) < 6
        ):  # each kind of strain compiles once more
            continue
        damping = {
            f"segments.{i}.damping": 5.0 * segment.damping
            for i, segment in enumerate(scene.segments)
        }
        model = ste.build_model(scene.replace(damping | {"integrator.columns": 2}))
        rest = ste.static_equilibrium(model, tension)
        if not rest.converged:
            continue
        rng = np.random.default_rng(number)
        off = rng.normal(size=model.coordinate_count)
        start = rest.q + 0.05 * off / np.linalg.norm(off) * model.coordinate_scale()
        motion = ste.simulate(
            model, tension, 600.0, 60.0, initial=ste.Simulation(model).reset(start)
        )
        distance = np.linalg.norm(motion.tip_pose[-1, :3, 3] - rest.tip_pose[:3, 3]) / rod_length(
            scene
        )
        farthest = max(farthest, float(distance))
        count = count + 1
    measured("scenes", count)
    measured("tip to equilibrium [lengths]", farthest)
    assert count > 0.2 * len(numbers)
    assert farthest < 1e-5
