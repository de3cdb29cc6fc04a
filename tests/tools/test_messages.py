"""Lines of progress: what they are about, and how often they are said."""

import soft_tendon_env as ste
from soft_tendon_env.model import build
from soft_tendon_env.tools.messages import naming, say_once


def test_lines_name_what_they_are_about_within_a_context(capsys):
    with naming("scene 'first'"):
        with naming("scene 'inner'"):
            say_once("a line within both")
        say_once("a line within one")
        say_once("a line within one")
    say_once("a line behind")
    assert capsys.readouterr().err.splitlines() == [
        "soft_tendon_env: scene 'inner': a line within both",
        "soft_tendon_env: scene 'first': a line within one",
        "soft_tendon_env: a line behind",
    ]


def test_what_is_compiled_for_a_model_is_said_with_scene_and_time(monkeypatch, capsys):
    monkeypatch.setattr(build, "_check_coordinates", lambda model: say_once("compiling"))
    scene = ste.load_scene("three_tendon")
    ste.build_model(scene, "scene")
    said = capsys.readouterr().err
    assert said.endswith(f"scene 'three_tendon', {build.FIRST_USE}: compiling\n")
