"""`soft-tendon identify` refuses what it cannot use in one line, before it writes anything."""

import pytest

MARKERS = "[markers.tip]\narc_length = 0.3\n"
HOLDS = "hold,tension_0,tension_1,tension_2,tip_x,tip_y,tip_z\na,1,0,0,0.29,0.03,0\nb,0,1,0,0.29,-0.02,0.02\n"


@pytest.mark.cases(
    "given, message",
    [
        ({"--markers": None}, "--markers is missing"),
        ({"--parameters": None}, "--parameters is missing"),
        ({"--parameters": "segments.*.dens"}, "segments.*.dens is no number of the scene: did you mean 'segments.*.density'?"),
        ({"--fidelity": "coarse"}, "fidelity is 'coarse': it should be"),
        ({"--noise": "0.5"}, "--noise is 0.5: it should be a positive length with its unit"),
        ({"--held-out": "2"}, "held_out is 2: it should be a share"),
        ({"data": "none.csv"}, "there is no file none.csv"),
    ],
)
def test_mistakes_are_told_in_one_line(refused, tmp_path, given, message):
    (tmp_path / "markers.toml").write_text(MARKERS)
    (tmp_path / "holds.csv").write_text(HOLDS)
    usual = {"data": "holds.csv", "--markers": "markers.toml", "--parameters": "segments.*.density", "--out": "."}
    data, *options = ({**usual, **given}).items()
    words = [word for option in options if option[1] is not None for word in option]
    assert message in refused("identify", "three_tendon", data[1], *words)
