"""Page of an estimate: one HTML file with tables and pictures inside, which needs nothing else."""

import importlib.util
from collections.abc import Sequence
from html import escape

import numpy as np

from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.identification.identify import Estimate

Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Header and rows."""
STYLE = """body { font: 15px/1.5 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 } td, th { padding: .25em .8em; border-bottom: 1px solid #ccc; text-align: right }
td:first-child, th:first-child { text-align: left } svg { max-width: 100%; height: auto } li { margin: .3em 0 }"""


def page(found: Estimate) -> str:
    """HTML of the page; without matplotlib it has no pictures."""
    title = f"{found.scene.name}: identified from {len(found.error_fit)} recordings"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _table(*error_table(found)),
        "<h2>Parameters</h2><p>SI units, mount.rotation in degrees; intervals at 95 %.</p>",
        _table(*parameter_table(found)),
        "<h2>Findings</h2>",
        "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in found.findings or ("Nothing was found to be missing.",)) + "</ul>",
        *_pictures(found),
        "<h2>Recordings</h2>",
        _recordings(found),
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(parts) + "\n</body></html>\n"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [("th", header), *(("td", row) for row in rows)]
    return (
        "<table>" + "".join("<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>" for tag, row in lines) + "</table>"
    )


def error_table(found: Estimate) -> Table:
    """Errors of fit and of held-out recordings, before and after."""
    counts = zip(("fit", "held out"), (found.error_fit.size, found.error_held_out.size), found.before, found.errors, strict=True)
    rows = [(name, str(count), number(1e3 * before), number(1e3 * after)) for name, count, before, after in counts]
    return ("markers' mean distance", "recordings", "before [mm]", "identified [mm]"), rows


def parameter_table(found: Estimate) -> Table:
    """Parameters with their intervals."""
    spread, rows = found.intervals, []
    for i, own in enumerate(found.parameters):
        every = ((spread.low[i], spread.high[i]), spread.linear[i], spread.bootstrap[i])
        prior = "-" if own.prior is None else f"{own.prior:.3g}{' of it' if own.is_factor else ''}"
        seen = "yes" if spread.identified[i] else "no"
        intervals = [f"{low:.4g} to {high:.4g}" for low, high in every]
        rows.append((own.name, f"{own.value:.4g}", f"{found.value[i]:.4g}", intervals[0], seen, *intervals[1:], prior))
    return ("parameter", "before", "identified", "95 % interval", "in the data", "linear", "bootstrap over recordings", "prior"), rows


def _recordings(found: Estimate) -> str:
    rows = []
    for readings, errors, kind in ((found.fitted, found.error_fit, "fit"), (found.held_out, found.error_held_out, "held out")):
        for own, error in zip(readings.recordings, errors, strict=True):
            rows.append((own.name, kind, ", ".join(f"{value:.3g}" for value in np.abs(own.command).max(axis=0)), number(1e3 * error)))
    return _table(("recording", "used for", f"commands [{found.scene.effects.command_unit}]", "error [mm]"), rows)


def _pictures(found: Estimate) -> list[str]:
    if importlib.util.find_spec("matplotlib") is None:
        return ['<p>No pictures: <code>pip install "soft_tendon_env[pictures]"</code></p>']
    from soft_tendon_env.identification.pictures import draw_correlation, draw_shapes

    shapes = f"<h2>Measured (dots) and simulated (crosses) markers</h2>{draw_shapes(found)}"
    return [shapes, f"<h2>Correlation of the parameters</h2>{draw_correlation(found)}"]
