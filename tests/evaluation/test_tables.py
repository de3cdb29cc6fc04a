"""Tables and verdicts of evaluations: numbers as people read them, cases worked out by hand."""

import json
import math

import pytest

from soft_tendon_env.evaluation.benchmark import gaps, verdict
from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.summaries import Mean, Standing, Summary
from soft_tendon_env.evaluation.tables import (
    error_table,
    error_text,
    markdown_table,
    number,
    number_tables,
    record_table,
    records,
    summary_cells,
    summary_table,
    with_seeds,
    write_markdown,
)

RMS = "position_error_rms"


def score_of(seed, error, total_reward=0.0):
    """Score of an episode with an error [m] of a rod of 1 m; None: it diverged."""
    cause = "too fast" if error is None else None
    if error is None:
        value = math.nan
    else:
        value = error
    return EpisodeScore(
        seed=seed,
        steps=10,
        errors={"position_error": ErrorScore(value, 2.0 * value)},
        settled=False,
        metrics={"effort": 5.0, "chatter": 0.1},
        total_reward=total_reward,
        reached=None,
        diverged=cause,
        action_time=0.001,
        length=1.0,
    )


def standing(*errors):
    """Of a single member, an episode per error [m]."""
    return Standing([[score_of(seed, error) for seed, error in enumerate(errors)]])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (math.nan, "-"),
        (0.0123456, "0.0123"),
        (-0.0, "0.00"),
        (1.0, "1.00"),
        (12.34, "12.3"),
        (-12.34, "-12.3"),
        (123.4, "123"),
        (999.4, "999"),
        (999.6, "1000"),
        (-12345.6, "-12346"),
        (math.inf, "inf"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_seeds_stand_behind_names():
    names = [with_seeds("ppo", count) for count in (None, 1, 5)]
    assert names == ["ppo", "ppo (1 seed)", "ppo (5 seeds)"]


def test_tables_are_aligned_and_lack_what_a_row_lacks():
    table = record_table([{"a": "1", "bb": "22"}, {"a": "333", "c": "4"}])
    assert table.split("\n") == [
        "| a   | bb | c |",
        "|-----|----|---|",
        "| 1   | 22 | - |",
        "| 333 | -  | 4 |",
    ]
    assert markdown_table(["x"], []) == "| x |\n|---|"


def summary_of(diverged=0, reached=None):
    return Summary(
        episodes=4,
        diverged=diverged,
        errors={"position_error": ErrorScore(0.0123, 0.05), "angle_error": ErrorScore(0.1, 0.2)},
        settled=3,
        metrics={"effort": 2.5, "chatter": 0.125},
        mean_return=1.0,
        reached=reached,
        action_time=0.0025,
    )


def test_cells_are_in_millimetres_degrees_and_milliseconds():
    cells = summary_cells(summary_of(reached=0.75))
    assert list(cells.values()) == ["12.3", "5.73", "75 %", "3 of 4", "2.50", "0.125", "2.50"]
    assert [*cells] == [
        "position [mm] RMS",
        "angle [deg] RMS",
        "reached",
        "settled",
        "effort [N]",
        "chatter [N]",
        "time [ms]",
    ]
    assert "reached" not in summary_cells(summary_of())


def test_divergences_are_flagged_and_explained():
    lived = summary_table("policy", {"a": summary_of()}, {"a": "none"})
    assert "!" not in lived
    assert lived.count("\n") == 2
    died = summary_table(
        "policy", {"a": summary_of(), "b": summary_of(diverged=1)}, {"a": "none", "b": "own"}
    )
    flagged = [line for line in died.split("\n") if "12.3 !" in line]
    assert len(flagged) == 1
    assert flagged[0].startswith("| b ")
    assert died.endswith("errors and metrics are those of the episodes that lived.")


def test_errors_are_interquartile_mean_and_mean_with_the_share_of_bad_episodes():
    """An episode is bad that diverged, or has more than a fiftieth of the rod's length."""
    assert error_text(standing(0.001, 0.002, 0.003, 0.010)) == "2.50 / 4.00"
    assert error_text(standing(0.001, 0.002, 0.003, 0.030)) == "2.50 / 9.00, 25 % bad"
    assert error_text(standing(0.001, 0.002, 0.003, None)) == "2.50 / inf, 25 % bad"
    assert error_text(standing(0.02, 0.02)) == "20.0 / 20.0"


def cells_of(table):
    """Cells of a Markdown table by rows, the heading first."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.split("\n")]
    return [rows[0], *rows[2:]]


def test_the_table_of_errors_has_policies_in_rows_and_conditions_in_columns():
    many = Standing([[score_of(0, 0.002)], [score_of(0, 0.004)]])
    standings = {("a", "x"): standing(0.001), ("b", "x"): many, ("a", "y"): standing(0.005)}
    assert cells_of(error_table(standings)) == [
        ["position [mm] RMS", "x", "y"],
        ["a", "1.00 / 1.00", "5.00 / 5.00"],
        ["b (2 seeds)", "3.00 / 3.00", "-"],
    ]


def test_narrow_tables_have_errors_returns_and_shares_of_bad_episodes():
    errors = (0.001, 0.002, 0.003, 0.030)
    scores = [score_of(seed, error, 100.0 * error) for seed, error in enumerate(errors)]
    standings = {("a", "x"): Standing([scores])}
    position, returns, bad = number_tables(standings)
    assert cells_of(position) == [["position [mm] RMS", "a"], ["x", "2.5 (9.0)"]]
    assert cells_of(returns) == [["return", "a"], ["x", "0.25 (0.90)"]]
    assert cells_of(bad) == [["bad episodes [%]", "a"], ["x", "25"]]


def test_narrow_tables_have_conditions_in_rows_and_policies_in_columns():
    many = Standing([[score_of(0, 0.002)], [score_of(0, 0.004)]])
    standings = {("a", "x"): standing(0.001), ("b", "x"): many, ("a", "y"): standing(0.005)}
    bad = number_tables(standings)[-1]
    assert cells_of(bad) == [
        ["bad episodes [%]", "a", "b (2 seeds)"],
        ["x", "0", "0"],
        ["y", "0", "-"],
    ]


def test_records_are_in_si_units_with_counts():
    standings = {("a", "x"): standing(0.001, 0.002, 0.003, 0.03)}
    (row,) = records(standings)
    assert row["policy"] == "a"
    assert row["condition"] == "x"
    assert row["members"] == 1
    assert row["episodes"] == 4
    assert row["bad"] == 1
    assert row[RMS] == 0.0025
    assert row[f"{RMS}_mean"] == 0.009
    # between the third and the fourth of four, at 2.7 of 3
    assert row[f"{RMS}_percentile_90"] == pytest.approx(0.003 + 0.7 * 0.027)
    assert row[f"{RMS}_low"] <= row[RMS] <= row[f"{RMS}_high"]


def test_gaps_are_of_the_best_of_both_kinds_where_both_play():
    """Errors are better where they are less, returns where they are more."""
    errors = {"good": 0.003, "poor": 0.009, "exact": 0.001, "weak": 0.005}
    standings = {}
    for name, error in errors.items():
        scores = [score_of(seed, error, total_reward=-error) for seed in range(4)]
        standings[name, "x"] = Standing([scores])
    standings["good", "y"] = standing(0.003)
    learned = {"good", "poor"}
    by_error = gaps(standings, learned, RMS)
    assert by_error.keys() == {"x"}
    assert by_error["x"] == pytest.approx((0.002, 0.002, 0.002))
    assert gaps(standings, learned, "return")["x"] == pytest.approx((0.002, 0.002, 0.002))


def test_the_bounds_of_a_gap_in_return_are_in_order():
    rewards = {"agent": (1.0, 2.0, 6.0), "controller": (3.0, 3.0, 3.0)}
    standings = {}
    for name, of_seeds in rewards.items():
        scores = [score_of(seed, 0.0, reward) for seed, reward in enumerate(of_seeds)]
        standings[name, "x"] = Standing([scores])
    gap = gaps(standings, {"agent"}, "return")["x"]
    assert gap.low <= gap.value <= gap.high
    assert (gap.low, gap.high) == pytest.approx((-3.0, 2.0))


def test_verdicts_say_where_intervals_leave_out_zero():
    ahead = Mean(-2.0, -3.0, -1.0)
    behind = Mean(2.0, 1.0, 3.0)
    between = Mean(0.0, -1.0, 1.0)
    touching = Mean(-0.5, -1.0, 0.0)
    _, items = verdict({"position": {"x": ahead, "y": behind, "z": between, "w": touching}})
    assert items == "- By position: ahead in x; behind in y; not separated in z, w."
    _, items = verdict({"return": {"x": behind, "y": behind}})
    assert items == "- By return: behind in all."
    assert verdict({"position": {}}) == []
    sentence, _ = verdict({"return": {"x": behind}}, "other policy")
    assert sentence.startswith("The best other policy")


def test_files_are_written_into_folders_that_are_made(tmp_path, capsys):
    page = tmp_path / "pages" / "of today" / "page.md"
    numbers = tmp_path / "numbers" / "of today" / "numbers.json"
    write_markdown(page, "# Results")
    write_json(numbers, {"errors": [0.5, math.nan, -math.inf], "name": "nan"})
    assert page.read_text() == "# Results\n"
    assert json.loads(numbers.read_text()) == {"errors": [0.5, None, None], "name": "nan"}
    assert capsys.readouterr().out.split("\n")[:2] == [f"written: {page}", f"written: {numbers}"]
