import numpy as np
import pytest

from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.envs.tracking import error_unit


@pytest.mark.parametrize(
    ("name", "value", "text", "title"),
    [
        ("position_error", 2.43e-5, "0.0243 mm", "position error [mm]"),
        ("backbone_error", 0.3, "300 mm", "backbone error [mm]"),
        ("angle_error", np.pi / 4, "45 deg", "angle error [deg]"),
        ("coordinate_error", 1.25, "1.25", "coordinate error"),
    ],
)
def test_errors_are_shown_in_units_that_people_use(name, value, text, title):
    assert name in {error.name for task in TASKS.values() for error in task.errors}
    assert error_unit(name).text(value) == text and error_unit(name).titled == title


def test_contact_has_units_too():
    assert error_unit("penetration").text(0.0012) == "1.2 mm" and error_unit("contact_force").titled == "contact force [N]"
