"""Trials: what is chosen keeps its error on other motions and loads, is found once, and says so
where nothing does."""

import itertools
import json
import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from soft_tendon_env.accuracy import coordinate_search, kept_trials
from soft_tendon_env.accuracy import trial as module
from soft_tendon_env.accuracy.candidates import bare_rod, strain_tables
from soft_tendon_env.accuracy.case_models import CaseModels, TrialInput
from soft_tendon_env.accuracy.choice import Choice
from soft_tendon_env.accuracy.fidelity import PRESETS, accuracy_of, at_fidelity
from soft_tendon_env.accuracy.hardest_motions import HardestMotions
from soft_tendon_env.accuracy.input_motions import (
    HOLD,
    USUAL,
    motion_tensions,
    tension_limits,
)
from soft_tendon_env.accuracy.kept_trials import choose, trial_digest
from soft_tendon_env.accuracy.loads import (
    REACH,
    covers,
    load_cases,
    reaches,
    scaled_effects,
    tried_effects,
)
from soft_tendon_env.accuracy.progress import Progress
from soft_tendon_env.accuracy.reference import (
    CONVERGING,
    Ladder,
    ReferenceMotion,
    distance,
    reference_motions,
    remaining_error,
    start_at_rest,
    tip_path,
)
from soft_tendon_env.accuracy.settling import settle
from soft_tendon_env.accuracy.trial import OWN, Trial
from soft_tendon_env.compiler.kept_code import cache_folder
from soft_tendon_env.effects import Effects
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.statics import RedundancyWarning
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import FidelityWarning, find_fields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools import files
from soft_tendon_env.tools.configuration import ConfigurationError

SHIPPED = load_scene("three_tendon")
ARM = SHIPPED.replace(
    {
        "segments.0.length": 0.2,
        "segments.0.radius": 0.011,
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
    }
)
SPRING = {
    "segments.0.curvature": [6.2, 0.0, 30.8],
    "segments.0.length": 0.6,
    "segments.0.young_modulus": 2e7,
    "segments.0.radius": 0.004,
}
STOCKY = {
    "segments.0.length": 0.3,
    "segments.0.radius": 0.025,
    "effects.tip_load.force": [0.0, 3.0, -4.0],
}
MOMENTS = {
    "type": "statics_based",
    "passive": [{"strains": list(STRAINS), "order": 6, "span": "rod"}],
}
STANDS = {"effects.gravity.acceleration": [-9.81, 0.0, 0.0]}
"""Own weight upon the arm; from a Young's modulus of 1.45 MPa on it stands."""
SPRINGS = {"stiffness": 700.0, "displacement_limits": [0.0, 0.02]}
TWO = {"segments.0.length": 0.25, "tendons.0.end": 0.11, "segments.0.curvature": [0.0, 4.0, 2.0]}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of trials in a cache of its own."""
    cache_folder()  # of kernels, which stays as it is
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path])
    return tmp_path / "soft_tendon_env" / "trials"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*only in a trial")  # of 1.4 s for the spring
@pytest.mark.parametrize("changes", [SPRING, STOCKY, TWO], ids=["spring", "stocky", "two pieces"])
def test_presets_keep_their_error_at_rest_and_in_motion(changes):
    """None above 1.5 times what it says, on tensions that the trial had not; the finer the preset
    the smaller the error."""
    scene = ARM.replace(changes)
    errors = []
    limits = np.array([tendon.tension_limits for tendon in scene.tendons]).T
    inputs = [
        *np.random.default_rng(7).uniform(*limits, (8, 3)),
        *(motion_tensions(scene, kind, 70, 1.5) for kind in USUAL),
    ]
    exact = reference_motions(scene, inputs, 2e-5 * rod_length(scene)).tips
    for preset in PRESETS:
        model = build_model(at_fidelity(scene, preset))
        errors.append(
            max(
                distance(tip_path(model, tensions), tips)
                for tensions, tips in zip(inputs, exact, strict=True)
            )
            / rod_length(scene)
        )
        assert errors[-1] <= 1.5 * PRESETS[preset].share, preset
    assert errors[2] < errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("changes", [STOCKY, TWO], ids=["stocky", "two pieces"])
@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_presets_keep_their_error_under_all_loads_of_the_range(changes, preset):
    """None above what it says, under loads from a third of the scene's to the largest ones."""
    scene = ARM.replace({**changes, "effects.tip_load.mass": 0.01})
    choice = coordinate_search.search(scene, PRESETS[preset])
    inputs = [
        *np.random.default_rng(8).uniform(*tension_limits(scene), (8, 3)),
        *(motion_tensions(scene, kind, 71, 1.0) for kind in USUAL),
    ]
    for factor in (0.33, 1.0, REACH):
        loaded = scene.replace({"effects": scaled_effects(scene.effects, factor)})
        assert covers(Effects(**choice.loads), loaded.effects)
        exact = reference_motions(loaded, inputs, 2e-5 * rod_length(scene)).tips
        model = build_model(choice.applied_to(loaded))
        errors = [
            distance(tip_path(model, tensions), tips)
            for tensions, tips in zip(inputs, exact, strict=True)
        ]
        assert max(errors) <= PRESETS[preset].share * rod_length(scene), factor


LARGEST = load_cases(ARM, REACH, 0)[1].model_dump(mode="json")
"""Table of the largest loads of a trial of ARM."""


def chosen_under(effects, coordinates=3, error=0.0):
    """A choice that was tried under effects of this table."""
    return Choice(
        strain=bare_rod(ARM),
        quadrature={"least": 6},
        integrator={"tolerance": 1e-5},
        coordinates=coordinates,
        error=error,
        inputs=20,
        loads=effects,
        reach=REACH,
    )


def test_it_is_made_once_and_kept(cache, monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 0.2)
    choice = choose(ARM, PRESETS["fast"])
    assert choice.error < PRESETS["fast"].share / module.LARGER_LOADS_MARGIN
    assert choice.coordinates == build_model(choice.applied_to(ARM)).coordinate_count
    (path,) = cache.glob("*.json")

    other = choice._replace(coordinates=99)
    monkeypatch.setattr(coordinate_search, "search", lambda scene, asked, least: other)
    assert choose(ARM, PRESETS["fast"]) == choice
    path.write_bytes(path.read_bytes()[:-9])  # damaged
    assert choose(ARM, PRESETS["fast"]).coordinates == 99
    assert json.loads(path.read_text())["choice"]["coordinates"] == 99

    def cannot(name):
        raise OSError(30, "read-only")

    monkeypatch.setattr(kept_trials, "new_data_folder", cannot)
    assert choose(ARM, PRESETS["fine"]).coordinates == 99


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"[1, 2]",
        b'{"choice": {"coordinates": 3}, "digest": "0"}',
        b"[" * 100_000,
    ],
    ids=["empty", "no text", "a list", "another digest", "deep"],
)
def test_a_damaged_file_of_a_trial_is_made_anew(cache, monkeypatch, content):
    monkeypatch.setattr(
        coordinate_search, "search", lambda scene, asked, least: chosen_under(LARGEST, 7)
    )
    choose(ARM, PRESETS["fast"])
    (path,) = cache.glob("*.json")
    path.write_bytes(content)
    assert choose(ARM, PRESETS["fast"]).coordinates == 7
    assert json.loads(path.read_text())["choice"]["coordinates"] == 7


@pytest.mark.parametrize("coordinates", [None, "7", 8])
def test_a_changed_number_of_a_trial_is_noticed(cache, monkeypatch, coordinates):
    monkeypatch.setattr(
        coordinate_search, "search", lambda scene, asked, least: chosen_under(LARGEST, 7)
    )
    choose(ARM, PRESETS["fast"])
    (path,) = cache.glob("*.json")
    file = json.loads(path.read_text())
    file["choice"]["coordinates"] = coordinates
    path.write_text(json.dumps(file))
    assert choose(ARM, PRESETS["fast"]).coordinates == 7


def test_a_trial_that_cannot_be_locked_is_made(cache, monkeypatch):
    monkeypatch.setattr(
        coordinate_search, "search", lambda scene, asked, least: chosen_under(LARGEST, 7)
    )
    key = trial_digest(ARM, PRESETS["fast"])
    (cache / f"{key}.lock").mkdir(parents=True)
    assert choose(ARM, PRESETS["fast"]).coordinates == 7


def test_smaller_loads_use_the_trial_again_and_larger_ones_begin_another(cache, monkeypatch):
    """In their directions: each is tried up to REACH times its size."""
    tried = []

    def made(scene, asked, least):
        tried.append(scene)
        greatest = load_cases(scene, REACH, 0)[1]
        return chosen_under(greatest.model_dump(mode="json"), coordinates=len(tried))

    monkeypatch.setattr(coordinate_search, "search", made)
    loaded = ARM.replace({"effects.tip_load": {"mass": 0.02, "force": [0.0, 0.1, 0.0]}})
    cases = [
        ({}, 1),
        ({"effects.tip_load.mass": 0.024}, 1),
        ({"effects.tip_load.mass": 0.0}, 1),
        ({"effects.gravity.acceleration": [0.0, 0.0, -11.0]}, 1),
        ({"effects.tip_load.force": [0.0, 0.07, 0.0]}, 1),
        ({"effects.gravity": None}, 1),
        ({"effects.tip_load.mass": 0.026}, 2),
        ({"effects.tip_load.force": [0.0, -0.1, 0.0]}, 3),
        ({"effects.fluid": {"density": 1000.0}}, 4),
        ({"effects.tip_load.mass": 0.02}, 1),
    ]
    for changes, coordinates in cases:
        changed = loaded.replace(changes)
        assert choose(changed, PRESETS["fast"]).coordinates == coordinates, changes
    assert len(tried) == 4
    assert len([*cache.glob("*.json")]) == 4


@pytest.mark.parametrize("preset", PRESETS)
def test_loads_within_the_range_begin_no_trial_at_any_preset(cache, monkeypatch, preset):
    """Nor one of a coarser preset, which would have to be compared only for the part that the first
    is not certain of."""
    tried = []

    def made(scene, asked, least):
        tried.append(asked)
        return chosen_under(LARGEST)

    monkeypatch.setattr(coordinate_search, "search", made)
    for factor in (1.0, 0.5, 1.2, 0.0):
        loads = scaled_effects(ARM.effects, factor)
        at_fidelity(ARM.replace({"effects": loads}), preset)
    assert tried == [PRESETS[preset]]


def test_a_trial_has_loads_up_to_its_range(monkeypatch):
    """The scene's own, REACH times as large ones, and smaller ones."""
    monkeypatch.setattr(module, "SECONDS", 0.1)
    trial = Trial(ARM, 1e-2, REACH)
    own, greatest, weaker = (np.array(case.gravity.acceleration) for case in trial.cases)
    np.testing.assert_allclose(greatest, REACH * own)
    assert 0.0 > weaker[2] > greatest[2]
    assert {test.case for test in trial.tests if test.reference.is_equilibrium} == {0, 1, 2}
    assert {test.case for test in trial.tests if not test.reference.is_equilibrium} == {0, 1}
    for test in trial.tests[:4]:
        changes = {"effects": trial.cases[test.case]}
        loaded = build_model(trial.scene.replace(changes))
        exact = reference_motions(loaded.scene, [test.commands], 1e-2 * trial.unit).tips[0]
        assert distance(test.reference.tips, exact) <= test.reference.error
    assert reaches(ARM) == (REACH, 1.0)
    assert reaches(SHIPPED) == (1.0,)


@pytest.mark.parametrize(
    ("left_out", "error", "reached"),
    [
        (0, 0.004, [REACH]),
        (2, 0.004, [REACH, 1.0]),  # larger loads buckle the arm
        (0, 0.02, [REACH, 1.0]),  # nothing is near enough under them
    ],
)
def test_larger_loads_are_not_asked_for_where_they_cannot_be_met(
    monkeypatch, left_out, error, reached
):
    tried = []

    class FakeTrial:
        def __init__(self, scene, share, reach, progress):
            self.reach = reach
            if reach > 1.0:
                self.left_out = left_out
            else:
                self.left_out = 0
            tried.append(reach)

    def best(trial, asked, progress, least):
        return chosen_under({}, 3, error if trial.reach > 1.0 else 0.004)

    monkeypatch.setattr(coordinate_search, "Trial", FakeTrial)
    monkeypatch.setattr(coordinate_search, "best_choice", best)
    assert coordinate_search.search(ARM, PRESETS["fast"]).error == 0.004
    assert tried == reached


def standing(young_modulus):
    """The arm that ships, with this Young's modulus [Pa], upright under its weight."""
    changes = {**STANDS, "segments.0.young_modulus": young_modulus}
    return SHIPPED.replace(changes)


@pytest.mark.slow
def test_a_column_that_falls_to_any_side_begins_no_motion(monkeypatch):
    """Refinements that began where the coarser one fell would agree, and models fall elsewhere."""
    monkeypatch.setattr(module, "SECONDS", 0.1)
    buckled = standing(1.3e6)
    ladder = Ladder(buckled, 1e-3)
    coarse = ladder.rung(0)
    fine = ladder.rung(1)
    assert ladder.buckles
    assert coarse.slack_rest is None
    assert fine.slack_rest is None
    by_itself = start_at_rest(fine.model)
    np.testing.assert_array_equal(fine.start.q, by_itself.q)

    trial = Trial(buckled, 1e-2)
    assert trial.missing == 1  # slack
    assert trial.not_unique == 3
    assert len(trial.tests) == 16
    for test in trial.tests:
        assert test.reference.is_equilibrium


def test_larger_loads_that_buckle_a_column_are_left_at_once(monkeypatch):
    monkeypatch.setattr(module, "refine_once", None)
    stands = standing(1.6e6)
    trial = Trial(stands, 1e-2, REACH)
    assert trial.not_unique == 1
    assert trial.tests == []

    ladders = []
    for case in trial.cases:
        loaded = stands.replace({"effects": case})
        ladders.append(Ladder(loaded, 1e-3))
    assert [ladder.buckles for ladder in ladders] == [False, True, False]
    assert ladders[0].rung(1).slack_rest is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("young_modulus", "most", "left_out"), [(2e5, 21, 4), (1.3e6, 9, 4), (1.6e6, 12, 0)]
)
def test_a_column_near_its_buckling_load_gets_few_coordinates(young_modulus, most, left_out):
    asked = PRESETS["fast"]
    choice = coordinate_search.search(standing(young_modulus), asked)
    assert choice.coordinates <= most
    assert choice.error <= asked.share / module.MARGIN
    assert choice.left_out == left_out


@pytest.mark.parametrize(("is_dropped", "coordinates"), [(True, [3, 7, 3]), (False, [3, 7])])
def test_what_an_input_ruled_out_is_judged_again_without_it(monkeypatch, is_dropped, coordinates):
    """If it turns out to be not unique."""
    monkeypatch.setattr(module, "USUAL", ())
    trial = Trial(ARM, 1e-2)
    doubtful = trial.tests[0]
    judged = []

    def judge(trial, settled, table, is_bounded):
        choice = settled.with_strain(trial.scene, table)
        count = trial.model(choice).coordinate_count
        judged.append(count)
        is_near = count > 3 or doubtful not in trial.tests
        if len(judged) == 2 and is_dropped:
            trial.tests.remove(doubtful)
            trial.not_unique += 1
        error = 0.001 if is_near else np.inf
        return choice._replace(coordinates=count, error=error)

    monkeypatch.setattr(coordinate_search, "judged", judge)
    monkeypatch.setattr(coordinate_search, "known_fields", lambda scene: None)
    choice = coordinate_search.best_choice(trial, PRESETS["fast"], Progress("arm", shown=False))
    assert judged == coordinates
    assert choice.coordinates == judged[-1]
    assert choice.not_unique == is_dropped


@pytest.mark.parametrize(("needed", "judgements"), [(1.0, 2), (0.2, 4), (0.0, 7)])
def test_steps_are_settled_anew_where_coordinates_have_doubled(monkeypatch, needed, judgements):
    """If none of those before was near enough: more coordinates would not help."""
    judged = []

    def judge(trial, settled, table, is_bounded):
        tolerance = settled.integrator["tolerance"]
        if is_bounded:
            judged.append((table["coordinates"], tolerance))
        is_near = table["coordinates"] > 5 and tolerance <= needed
        error = 0.001 if is_near or not is_bounded else np.inf
        return settled._replace(coordinates=table["coordinates"], error=error)

    few = chosen_under({}, 4)._replace(integrator={"tolerance": 1.0})
    monkeypatch.setattr(coordinate_search, "settle", lambda trial, asked: few)
    monkeypatch.setattr(
        coordinate_search, "settled_steps", lambda trial, choice: choice.with_finer_steps(5.0)
    )
    tables = [{"coordinates": count} for count in (3, 7, 8, 10, 16)]
    monkeypatch.setattr(coordinate_search, "strain_tables", lambda *_: iter(tables))
    monkeypatch.setattr(coordinate_search, "judged", judge)
    progress = SimpleNamespace(candidate=lambda: None)
    trial = SimpleNamespace(tests=[1], scene=ARM)
    choice = coordinate_search._first_near(trial, PRESETS["fast"], progress, 0)
    every = [(3, 1.0), (7, 1.0), (8, 1.0), (8, 0.2), (10, 0.2), (16, 0.2), (16, 0.04)]
    np.testing.assert_allclose(judged, every[:judgements])
    assert np.isfinite(choice.error)


@pytest.mark.parametrize(
    ("left_out", "tried"),
    [
        (0, [("fine", 0)]),
        (3, [("fine", 0), ("standard", 0), ("fast", 0), ("fine", 12)]),
    ],
)
def test_a_preset_that_left_out_inputs_has_no_fewer_coordinates_than_coarser_ones(
    monkeypatch, left_out, tried
):
    names = {asked: name for name, asked in PRESETS.items()}
    counts = {"fast": 6, "standard": 12, "fine": 9}
    calls = []

    def chosen(scene, asked, least=0):
        calls.append((names[asked], least))
        count = max(counts[names[asked]], least)
        return chosen_under(LARGEST, count)._replace(not_unique=left_out)

    monkeypatch.setattr("soft_tendon_env.accuracy.fidelity.choose", chosen)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        at_fidelity(ARM, "fine")
    assert calls == tried
    assert len(caught) == (left_out > 0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"not_unique": 2}, "a trial without 2 inputs under which"),
        (
            {"seconds": 0.36, "growth": ((0.2, 4e-4), (0.5, np.inf))},
            "for 0.36 s, not known after 0.36 s",
        ),
        ({"seconds": 0.5, "growth": ((0.5, 2e-3), (2.0, 0.031))}, "for 0.5 s, 3.1 % after 2 s"),
        ({"tensions": 0.25}, "under 0.25 of the tensions of the usual motions"),
        ({"error": 0.4, "seconds": 0.1}, "as 'fine' asks.*for 0.1 s"),
    ],
)
def test_what_a_promise_does_not_speak_of_is_told_each_time(monkeypatch, change, reason):
    """By a warning, and nowhere as inf; the choice is that of the coarser preset if that states
    less."""
    choices = {
        PRESETS["fast"]: chosen_under(LARGEST, 9, 0.004),
        PRESETS["standard"]: chosen_under(LARGEST, 12, 0.5),
        PRESETS["fine"]: chosen_under(LARGEST, 15, 2e-4)._replace(**change),
    }
    monkeypatch.setattr(
        "soft_tendon_env.accuracy.fidelity.choose", lambda scene, asked, least=0: choices[asked]
    )
    if choices[PRESETS["fine"]].error > 0.1:
        choices[PRESETS["standard"]] = choices[PRESETS["fine"]]._replace(error=0.6)
        choices[PRESETS["fast"]] = choices[PRESETS["fine"]]._replace(error=0.7)
    for _ in range(2):
        with pytest.warns(FidelityWarning, match=reason) as caught:
            at_fidelity(ARM, "fine")
        assert "inf" not in str(caught[0].message)


def test_a_finer_preset_states_no_larger_error_than_a_coarser_one(monkeypatch):
    choices = {
        PRESETS["fast"]: chosen_under(LARGEST, 9, 0.004),
        PRESETS["standard"]: chosen_under(LARGEST, 12, 0.02),
    }
    monkeypatch.setattr(
        "soft_tendon_env.accuracy.fidelity.choose", lambda scene, asked, least=0: choices[asked]
    )
    with pytest.warns(FidelityWarning, match=r"'standard' asks.*9 coordinates.*within 0.4 %"):
        at_fidelity(ARM, "standard")


def modes_of(table):
    """Legendre modes of a strain table without POD modes."""
    return table.get("passive", table.get("modes"))


def test_no_table_is_judged_twice():
    """A rod of one part has the same fields over it and over each part."""
    seen = []
    for table in strain_tables(ARM, None):
        fields = [(mode["strains"], mode["order"]) for mode in modes_of(table)]
        seen.append((table["type"], fields))
    assert all(seen.count(fields) == 1 for fields in seen)


def test_a_rod_of_two_parts_has_fields_over_each_and_over_all():
    spans = []
    for table in strain_tables(ARM.replace(TWO), None):
        for mode in modes_of(table):
            if mode["order"] == 2:
                spans.append(mode["span"])
    assert sorted(spans) == ["piece", "piece", "rod", "rod"]


@pytest.mark.slow
def test_tables_have_the_least_number_of_coordinates_that_is_asked_for():
    counts = []
    for table in itertools.islice(strain_tables(ARM, None, least=20), 8):
        model = build_model(ARM.replace({"strain": table}))
        counts.append(model.coordinate_count)
    assert counts[0] >= 20
    assert counts == sorted(counts)


@pytest.mark.parametrize(
    ("change", "same"),
    [
        (
            {
                "name": "other",
                "quadrature.intervals": 9,
                "integrator.step": 0.01,
                "strain.passive": [],
                "effects.actuators.time_constant": 0.1,
            },
            True,
        ),
        (
            {
                "effects.contact.obstacles": [
                    {"type": "plane", "position": [0.0, 0.0, -0.5], "axis": [0.0, 0.0, 1.0]}
                ]
            },
            True,
        ),
        ({"segments.0.density": 1100.0}, False),
        ({"tendons.0.tension_limits": [0.0, 1.0]}, False),
        ({"effects.tendon_elasticity": SPRINGS}, False),
        ({"effects.gravity.acceleration": [0.0, 0.0, 9.81]}, True),
        ({"strain": {"type": "statics_based", "strains": ["bend_y", "bend_z"]}}, False),
    ],
)
def test_another_arm_or_accuracy_is_another_trial(change, same):
    fast = PRESETS["fast"]
    assert (trial_digest(ARM.replace(change), fast) == trial_digest(ARM, fast)) == same
    assert trial_digest(ARM, fast) != trial_digest(ARM, PRESETS["fine"])


def test_where_nothing_reaches_it_a_preset_warns_and_a_length_is_refused(monkeypatch):
    loads = load_cases(ARM, REACH, 0)[1].model_dump(mode="json")
    best = chosen_under(loads, 3, 0.012)
    monkeypatch.setattr(coordinate_search, "search", lambda scene, asked, least: best)
    with pytest.warns(
        FidelityWarning,
        match=r"as 'fast' asks, 1 % of the length.*3 coordinates, were within 1.2 %",
    ) as caught:
        at_fidelity(ARM, "fast")
    assert caught[0].filename == __file__
    with pytest.raises(ConfigurationError, match=r"as '1mm' asks, 0.5 %"):
        at_fidelity(ARM, "1mm")
    assert at_fidelity(ARM, "4mm").strain.passive == ()


@pytest.mark.parametrize(
    ("missing", "not_unique", "reason"),
    [
        (18, 2, "full physics has no motion under.*in 18 of 20 inputs.*: reduce tension_limits"),
        (2, 18, "is not unique .*disagree in 18 of 20 inputs.*: reduce tension_limits"),
        (0, 0, "none of the coordinates that were tried can follow.*: reduce tension_limits"),
    ],
)
def test_where_there_is_no_reference_it_says_why_and_what_to_do(
    monkeypatch, capsys, missing, not_unique, reason
):
    """And never that the tip is within inf %."""
    loads = load_cases(ARM, REACH, 0)[1].model_dump(mode="json")
    choice = chosen_under(loads, 3, np.inf)._replace(missing=missing, not_unique=not_unique)
    monkeypatch.setattr(coordinate_search, "search", lambda scene, asked, least: choice)
    monkeypatch.setattr(kept_trials, "say_once", print)
    changes = {"segments.0.density": 700.0 + missing}
    other = ARM.replace(changes)
    with pytest.warns(FidelityWarning, match=f"the accuracy of .* is not known: .*{reason}"):
        at_fidelity(other, "fast")
    assert "inf" not in capsys.readouterr().out


def test_fields_of_the_arms_own_need_no_trial_and_others_are_tried(monkeypatch):
    monkeypatch.setattr("soft_tendon_env.accuracy.fidelity.choose", None)
    fields = find_fields(SHIPPED)
    assert at_fidelity(SHIPPED, "fast").strain.passive.digest == fields.digest
    changes = {"segments.0.young_modulus": 0.6 * SHIPPED.segments[0].young_modulus}
    softer = SHIPPED.replace(changes)
    tables = [*strain_tables(softer, find_fields(softer))]
    assert {"type": "snapshots", "fields": 6, "digest": fields.digest} in [
        table.get("passive") for table in tables
    ]


def test_strains_and_loads_of_the_rod_stay():
    kirchhoff = ARM.replace(
        {
            "strain": {
                "type": "statics_based",
                "strains": ["bend_y", "bend_z"],
                "include_loads": True,
            }
        }
    )
    tables = [
        kirchhoff.replace({"strain": table}).strain for table in strain_tables(kirchhoff, None)
    ]
    assert all({*strain.free} == {"bend_y", "bend_z"} for strain in tables)
    assert all(strain.include_loads for strain in tables if strain.type == "statics_based")


@pytest.mark.slow
def test_quadrature_and_steps_are_settled(monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 0.2)
    changes = {"segments.0.curvature": [0.0, 0.0, 70.0]}
    curled = ARM.replace(changes)
    trial = Trial(curled, 2e-3)
    choice = settle(trial, accuracy_of(curled, "standard"))
    assert choice.quadrature["least"] > PRESETS["standard"].least
    assert trial.agree_at_rest(choice, choice.with_intervals(3.0), 0.5)
    assert trial.agree_in_motion(choice, choice.with_finer_steps(10.0), 0.5)


@pytest.mark.slow
def test_what_full_physics_is_unsure_of_counts_or_is_left_out(monkeypatch):
    model = build_model(ARM)
    monkeypatch.setattr(module, "USUAL", ())
    refine = ReferenceMotion.refine

    def refined(motions, label, done):
        for place, motion in enumerate(motions):
            refine(motion)
            motion.tips = tip_path(model, motion.commands)
            motion.errors = np.full(1, error)
            done(place, None)

    monkeypatch.setattr(module, "refine_once", refined)
    monkeypatch.setattr(ReferenceMotion, "refine", lambda motion: setattr(motion, "depth", 3))
    for error, left_out in ((1e-7, 0), (1e-4, 0), (1.0, 17)):
        trial = Trial(ARM, 2e-3)
        assert trial.left_out == trial.not_unique == left_out
        if not left_out:
            assert trial.distance(model) == pytest.approx(error)
    choice = chosen_under({}, 3, 0.012)._replace(not_unique=17)
    assert "without 17 inputs under which the arm's motion is not unique" in choice.describe(ARM)


def test_a_reference_is_refined_only_where_a_decision_depends_on_it(monkeypatch):
    """Near enough or too far, whatever its error; in between it is refined."""
    monkeypatch.setattr(module, "USUAL", ())
    trial = Trial(ARM, 2e-3)
    enough = trial.unit / module.MARGIN
    (test, *_) = trial.tests
    tips = test.reference.tips
    for away, depth in ((0.1, 2), (3.0, 2), (0.9, 3)):
        reference = ReferenceMotion(test.reference.ladder, test.commands)
        reference.refine()
        reference.refine()
        reference.errors = np.full(1, 0.4 * enough)
        moved = tips + np.array([0.0, away * enough, 0.0])
        trial._decide(TrialInput(reference, OWN), moved, enough)
        assert reference.depth == depth, away


LIVELY = SHIPPED.replace(
    {
        "segments.0.length": 0.22,
        "segments.0.radius": 0.009,
        "segments.0.young_modulus": 8e5,
        "segments.0.damping": 60.0,
    }
)
"""An arm with so little damping that its motions last."""


@pytest.mark.slow
def test_a_motion_is_known_as_far_as_its_work_reaches():
    """The errors bound those of a finer level, at all times."""
    tensions = motion_tensions(LIVELY, "redrawn", 12, 0.4)
    ladder = Ladder(LIVELY, 1e-3 * rod_length(LIVELY))
    whole = ReferenceMotion(ladder, tensions)
    for _ in range(3):
        whole.refine()
    assert whole.is_whole
    assert np.all(np.diff(whole.errors) >= 0.0)

    cut = ReferenceMotion(ladder, tensions, most_work=1e6)
    cut.refine()
    assert not cut.is_whole
    assert cut.error == np.inf
    cut.refine()
    count = len(cut.tips)
    off = cut.tips - whole.tips[:count]
    away = np.linalg.norm(off, axis=1)
    errors = cut.errors + whole.errors[:count]
    assert np.all(away <= errors)
    within = cut.rows_within(cut.errors[3])
    assert cut.errors[within] <= cut.errors[3]


def test_a_motion_ends_where_levels_have_strayed_from_one_another():
    tensions = motion_tensions(LIVELY, "redrawn", 12, 0.4)
    motion = ReferenceMotion(Ladder(LIVELY, 1e-3), tensions, lost=1e-7)
    motion.refine()
    motion.refine()
    assert len(motion.tips) < len(tensions) + 1


@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.3, 0.6])
def test_what_is_left_of_a_geometric_series_is_bounded(ratio):
    errors = 3e-4 * ratio ** np.arange(6)
    changes = errors[:-1] - errors[1:]
    for level in range(1, 4):
        change = np.full(2, changes[level])
        change_before = np.full(2, changes[level - 1])
        bound = remaining_error(change, change_before)
        left = errors[level + 1]
        assert np.all(bound >= (1.0 - 1e-12) * left)
        assert np.all(bound <= change) or ratio >= CONVERGING
    np.testing.assert_array_equal(remaining_error(changes, None), changes)


@pytest.mark.slow
def test_where_work_ends_a_trial_says_for_how_long_it_promises(monkeypatch, cache):
    """Again where the choice is read from the cache."""
    monkeypatch.setattr(module, "MOST_WORK", 1e7)
    monkeypatch.setattr(coordinate_search, "strain_tables", lambda scene, fields, least: [MOMENTS])
    heard = []
    for _ in range(2):
        with pytest.warns(FidelityWarning, match=r"'fast'.*1 % of the length") as caught:
            at_fidelity(LIVELY, "fast")
        heard.append(str(caught[0].message))
    assert heard[0] == heard[1]
    assert re.search(r"1 % of the length for [01]\.?\d* s", heard[0])
    assert "inf" not in heard[0]
    (path,) = cache.glob("*.json")
    record = json.loads(path.read_text())["choice"]
    assert 0.2 <= record["seconds"] < 2.0
    bounds = [bound for _, bound in record["growth"]]
    assert bounds == sorted(bounds)


def test_a_motion_that_is_not_certain_is_tried_with_smaller_tensions(monkeypatch):
    monkeypatch.setattr(module, "USUAL", ("redrawn",))
    monkeypatch.setattr(module, "SECONDS", 0.2)
    monkeypatch.setattr(module, "RESTS", 0)
    certain = Trial._certain_rows
    usual = HardestMotions(LIVELY).hardest("redrawn", module.SEED, 0.2)

    def rows(trial, reference):
        is_motion = not reference.is_equilibrium
        if is_motion and reference.commands.max() > 0.3 * usual.max():
            return 0
        return certain(trial, reference)

    monkeypatch.setattr(Trial, "_certain_rows", rows)
    trial = Trial(LIVELY, 1e-2)
    assert trial.left_out == 0
    assert trial.share == 0.25
    (motion,) = [test for test in trial.tests if not test.reference.is_equilibrium]
    np.testing.assert_allclose(motion.commands, 0.25 * usual)


def test_trials_have_what_tendons_do_and_nothing_else_of_actuation():
    friction = {"coefficient": 0.3, "stiction_speed": 1e-5}
    springs = {"stiffness": 5e3, "displacement_limits": [-0.1, 0.1], "strength": 10.0}
    changes = {
        "effects.tendon_friction": friction,
        "effects.tendon_elasticity": springs,
        "effects.actuators": {"time_constant": 0.05},
    }
    effects = SHIPPED.replace(changes).effects
    assert {*tried_effects(effects).chosen()} == {"tendon_elasticity", "tendon_friction"}
    assert covers(tried_effects(effects), effects)
    other = SHIPPED.replace({"effects.tendon_friction": {**friction, "coefficient": 0.4}}).effects
    assert not covers(tried_effects(effects), other)
    assert not covers(Effects(), effects)
    without = SHIPPED.replace({"effects.tendon_friction": {**friction, "coefficient": 0.0}}).effects
    assert not tried_effects(without).chosen()
    assert covers(Effects(), without)


@pytest.mark.parametrize(("coefficient", "is_tried"), [(0.0, False), (0.05, False), (0.5, True)])
def test_errors_of_shipped_fields_hold_for_light_friction(monkeypatch, coefficient, is_tried):
    tried = []
    choice = Choice({"type": "statics_based"}, {"least": 6}, {}, 3, 1e-4)

    def choose(scene, asked, least=0):
        tried.append(scene)
        return choice

    monkeypatch.setattr("soft_tendon_env.accuracy.fidelity.choose", choose)
    rubbing = SHIPPED.replace({"effects.tendon_friction.coefficient": coefficient})
    at_fidelity(rubbing, "fast")
    assert bool(tried) == is_tried


@pytest.mark.parametrize(("stretch", "is_tried"), [(0.0005, False), (0.009, False), (0.04, True)])
def test_errors_of_shipped_fields_hold_for_stiff_tendons(monkeypatch, stretch, is_tried):
    """Those that their greatest tension stretches by little of the arm's length."""
    tried = []

    def choose(scene, asked, least=0):
        tried.append(scene)
        return Choice({"type": "statics_based"}, {"least": 6}, {}, 3, 1e-4)

    monkeypatch.setattr("soft_tendon_env.accuracy.fidelity.choose", choose)
    stiffness = tension_limits(SHIPPED)[1].max() / (stretch * rod_length(SHIPPED))
    springs = {"stiffness": stiffness, "displacement_limits": [0.0, 0.1]}
    at_fidelity(SHIPPED.replace({"effects.tendon_elasticity": springs}), "fast")
    assert bool(tried) == is_tried


@pytest.mark.slow
@pytest.mark.parametrize("coefficient", [0.6, 1.0])
def test_presets_keep_their_promise_where_rubbing_tendons_are_let_out(coefficient):
    """A bent guide that is pulled and released, against explicit strain."""
    strains = {"strains": [*STRAINS], "order": 7, "span": "piece"}
    part = {
        "length": 0.15,
        "young_modulus": 1e6,
        "poisson_ratio": 0.45,
        "density": 1000.0,
        "damping": 2e4,
        "radius": 0.01,
        "curvature": [0.0, 0.0, 6.0],
    }
    tendon = {
        "routing": {"type": "straight", "offset": [0.008, 0.0]},
        "tension_limits": [0.0, 1.6],
    }
    scene = Scene.model_validate(
        {
            "name": "guide",
            "segments": [part, part],
            "tendons": [tendon],
            "effects": {"tendon_friction": {"coefficient": coefficient}},
        }
    )
    exact = scene.replace(
        {"strain": {"type": "explicit", "modes": [strains]}, "quadrature.intervals": 12}
    )
    rises = np.linspace(0.0, 1.4, 60)[:, None]
    tensions = np.concatenate([rises, rises[:20:-1]])
    tips = tip_path(build_model(exact), tensions)
    for preset in ("fast", "standard"):
        model = build_model(at_fidelity(scene, preset))
        path = tip_path(model, tensions)
        allowed = PRESETS[preset].share * rod_length(scene)
        assert distance(path, tips) <= allowed, preset


@pytest.mark.slow
def test_a_lightly_damped_arm_keeps_what_it_promises():
    """For the time that it says, on tensions that the trial had not."""
    inputs = [motion_tensions(LIVELY, kind, 72, 2.0) for kind in USUAL]
    exact = reference_motions(LIVELY, inputs, 2e-4 * rod_length(LIVELY), most=4).tips
    counts = []
    for preset in ("fast", "standard"):
        choice = coordinate_search.search(LIVELY, PRESETS[preset])
        model = build_model(choice.applied_to(LIVELY))
        counts.append(choice.coordinates)
        samples = round(choice.seconds / HOLD) + 1
        assert choice.seconds > 0.5
        for tensions, tips in zip(inputs, exact, strict=True):
            path = tip_path(model, tensions)
            away = distance(path[:samples], tips[:samples])
            allowed = PRESETS[preset].share * rod_length(LIVELY)
            assert away <= allowed, preset
    assert counts == sorted(counts)


@pytest.mark.slow
def test_presets_keep_their_promise_with_elastic_tendons():
    """That pull as displacements, which the trial had not, go over a third of their range."""
    elastic = LIVELY.replace(
        {"segments.0.damping": 2e3, "effects.tendon_elasticity": SPRINGS | {"stiffness": 1200.0}}
    )
    inputs = [motion_tensions(elastic, kind, 73, 2.0) / 1200.0 for kind in USUAL]
    exact = reference_motions(elastic, inputs, 5e-5 * rod_length(elastic), most=4).tips
    for preset in ("fast", "standard"):
        choice = coordinate_search.search(elastic, PRESETS[preset])
        assert choice.speaks_of_all
        model = build_model(choice.applied_to(elastic))
        for commands, tips in zip(inputs, exact, strict=True):
            path = tip_path(model, commands)
            allowed = PRESETS[preset].share * rod_length(elastic)
            assert distance(path, tips) <= allowed, preset


def test_motions_of_elastic_tendons_are_displacements(monkeypatch):
    """Within limits; rests are under tensions, as those of other tendons."""
    monkeypatch.setattr(module, "SECONDS", 0.1)
    monkeypatch.setattr(module, "RESTS", 2)
    elastic = ARM.replace({"effects.tendon_elasticity": SPRINGS})
    trial = Trial(elastic, 1e-2)
    without = Trial(ARM, 1e-2)
    assert len(trial.tests) == len(without.tests) == 6
    for test, other in zip(trial.tests, without.tests, strict=True):
        if test.reference.is_equilibrium:
            np.testing.assert_array_equal(test.commands, other.commands)
        else:
            longest = test.commands.max()
            greatest_stretch = tension_limits(ARM)[1].max() / 700.0
            assert longest <= 0.02
            assert longest > 0.1 * greatest_stretch


def test_models_that_are_tried_warn_of_nothing(monkeypatch):
    """Nobody asked for them: redundant tendons of one that is chosen are told when it is used."""

    def best(trial, asked, progress, least):
        warnings.warn("a model that is tried", RedundancyWarning, stacklevel=2)
        return chosen_under({})

    monkeypatch.setattr(coordinate_search, "Trial", lambda *_: SimpleNamespace(left_out=0))
    monkeypatch.setattr(coordinate_search, "best_choice", best)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coordinate_search.search(SHIPPED, PRESETS["fast"])
    with pytest.warns(RedundancyWarning):
        best(None, None, None, 0)


def test_a_motion_ends_where_it_is_too_far(monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 0.4)
    trial = Trial(ARM, 1e-2)
    model = build_model(ARM.replace({"strain.passive": []}))
    models = CaseModels(trial.cases, model)
    (test, *_) = [test for test in trial.tests if not test.reference.is_equilibrium]
    path = models.path(test)
    expected_path = tip_path(model, test.commands)
    np.testing.assert_array_equal(path, expected_path)
    away = distance(path, test.reference.tips)
    assert models.path(test, 1.001 * away) is not None
    assert models.path(test, 0.999 * away) is None


def test_equilibria_are_refined_from_the_coarser_level():
    """To those of the path from the unloaded arm, to the residual of Newton's method."""
    ladder = Ladder(ARM, 1e-6)
    tensions = tension_limits(ARM)[1] * [0.3, 0.0, 0.6]
    motion = ReferenceMotion(ladder, tensions)
    motion.refine()
    motion.refine()
    fine = ladder.rung(1).model
    assert distance(motion.tips, tip_path(fine, tensions)) < 1e-9
    assert 0.0 < motion.error < 1e-4


def test_the_bar_names_the_scene_and_the_time_to_go(capsys, monkeypatch):
    monkeypatch.setattr("soft_tendon_env.tools.progress.QUIET", False)
    with Progress("my_arm") as progress:
        progress.plan(10.0)
        for _ in range(4):
            progress.reference(3.0)
        progress.candidate()
        share = progress._bar.n
    assert 0.7 < share < 1.0
    lines = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"my_arm, trial of its accuracy: \d\d %, \d+ s to go", lines[-1])
    assert len(lines) <= 10
