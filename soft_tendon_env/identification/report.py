"""Report of an estimate in Markdown: errors, parameters with their intervals, findings, recordings."""

import numpy as np

from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.identification.identify import Estimate


def summary(found: Estimate) -> str:
    """Tables of errors and parameters, and the findings."""
    counts = zip(("fit", "held out"), (found.error_fit.size, found.error_held_out.size), found.before, found.errors, strict=True)
    errors = [(name, str(count), number(1e3 * before), number(1e3 * after)) for name, count, before, after in counts]
    spread = found.intervals
    pairs = zip(found.parameters, found.value, spread.low, spread.high, spread.identified, strict=True)
    rows = [
        (own.name, f"{own.value:.4g}", f"{value:.4g}", f"{low:.4g} to {high:.4g}", "yes" if seen else "no")
        for own, value, low, high, seen in pairs
    ]
    tables = [
        markdown_table(("markers' mean distance", "recordings", "before [mm]", "identified [mm]"), errors),
        markdown_table(("parameter", "before", "identified", "95 % interval", "in the data"), rows),
    ]
    return "\n\n".join([*tables, *(["\n".join(f"- {text}" for text in found.findings)] if found.findings else [])])


def page(found: Estimate) -> str:
    """The summary, and the error of each recording."""
    rows = []
    for readings, errors, kind in ((found.fitted, found.error_fit, "fit"), (found.held_out, found.error_held_out, "held out")):
        for own, error in zip(readings.recordings, errors, strict=True):
            rows.append((own.name, kind, ", ".join(f"{value:.3g}" for value in np.abs(own.command).max(axis=0)), number(1e3 * error)))
    table = markdown_table(("recording", "used for", f"commands [{found.scene.effects.command_unit}]", "error [mm]"), rows)
    return f"# {found.scene.name}: identified from {len(found.error_fit)} recordings\n\n{summary(found)}\n\n{table}\n"
