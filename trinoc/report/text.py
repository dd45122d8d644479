"""Results as tables for a terminal."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from trinoc.evaluation.sweep import Row
from trinoc.match.tracks.matches import Matches
from trinoc.report.matches_part import counts_of_steps, reasons_by_view
from trinoc.report.numbers import significant_decimals, with_decimals, with_sigma, with_sign
from trinoc.report.parameter_table import LABELS, ParameterError


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> str:
    """Aligned columns: the first `left` to the left, the others to the right."""
    table = [list(head), *(list(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    )


def errors_text(errors: Sequence[ParameterError], reference_name: str) -> str:
    """Recovered parameters with sigmas beside known ones."""
    rows = []
    for number, found in enumerate(errors):
        first = number == 0 or errors[number - 1].camera != found.camera
        rows.append(
            (
                found.camera if first else "",
                LABELS[found.parameter],
                with_sigma(found.value, found.sigma),
                with_decimals(found.known, 3),
                with_sign(found.error, significant_decimals(found.sigma)),
                with_sign(found.over_sigma, 1),
            )
        )
    head = ("camera", "parameter", "found", reference_name, "error", "error/sigma")
    return text_table(head, rows, left=2)


def counts_text(matches: Matches) -> str:
    """What each step of the matching produced and rejected."""
    table = text_table(("matching", "count"), counts_of_steps(matches))
    return "\n".join([table, *matches.notes])


def reasons_text(matches: Matches) -> str:
    """What became of the segments of each view."""
    rows = [
        (words, *(str(count) for count in counts.values()))
        for words, counts in reasons_by_view(matches).items()
    ]
    totals = [str(len(np.asarray(matches.reasons[view]))) for view in matches.views]
    return text_table(("segments", *matches.views), [*rows, ("all", *totals)])


_KNOBS = {
    "tolerance_px": "tolerance",
    "false_alarms": "alarms",
    "least_contrast": "contrast",
    "least_posterior": "posterior",
    "stage": "stage",
    "form": "form",
}


def evaluation_text(rows: Sequence[Row]) -> str:
    """A line for each setting: the knobs that differ, then what came of it."""
    head, table = evaluation_table(rows)
    done = [row.evaluation for row in rows if row.evaluation is not None]
    parts = [text_table(head, table, left=0)]
    if done:
        low, high = done[0].tolerances_mm[0], done[0].tolerances_mm[-1]
        parts.append(
            "distance: of the length put out from the nearest edge, mm, half and 95 % of it\n"
            f"precision, completeness: shares of length within {low:g} and {high:g} mm\n"
            f"wanted: {done[0].wanted}, {done[0].length_wanted_mm:.0f} mm\n"
            "angle (deg) and length (mm): median error of lines on edges, of edges found\n"
            "sigmas: share of the errors across within 1.96 sigma (true: 95 %), and by how much\n"
            "the sigma of the median line is too small (true: 1)"
        )
    for row in rows:
        if row.evaluation is not None and row.evaluation.wireframe is not None:
            parts.append(_wireframe_text(row.evaluation.wireframe.record()))
    motions = [found.motion for found in done if found.motion is not None]
    if motions:
        parts.append(
            "after laying the segments on the shape: turned by "
            + ", ".join(f"{motion.turn_deg:.4f}" for motion in motions)
            + " deg, shifted by "
            + ", ".join("(" + " ".join(f"{x:.3f}" for x in m.shift_mm) + ")" for m in motions)
            + " mm"
        )
        if any(motion.rank < 6 for motion in motions):
            parts.append("the edges leave a part of this motion free, which was not moved")
    parts.extend(dict.fromkeys(row.problem for row in rows if row.problem))
    return "\n\n".join(parts)


def _wireframe_text(found: dict[str, Any]) -> str:
    return (
        f"wire frame: {found['edges_found']} of {found['edges_wanted']} edges found, "
        f"{found['edges_extra']} extra; {found['corners_found']} of {found['corners_wanted']} "
        f"corners found, {found['corners_extra']} extra, median error "
        f"{_number(found['corner_error_median_mm'], 3)} mm, "
        f"{_number(found['share_of_corners_within_95'], 3)} in their 95 % ellipsoids; "
        f"{found['faces']} faces"
    )


def evaluation_table(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """(names of the columns, cells): knobs with several values first."""
    records = [row.record() for row in rows]
    swept = [name for name in _KNOBS if len({str(r.get(name)) for r in records}) > 1]
    done = [row.evaluation for row in rows if row.evaluation is not None]
    low, high = (done[0].tolerances_mm[0], done[0].tolerances_mm[-1]) if done else (0.0, 0.0)
    head = [_KNOBS[name] for name in swept]
    head += ["segments", "lines", "distance", "95 %"]
    head += [f"{name} {at:g}" for name in ("prec.", "compl.") for at in (low, high)]
    head += ["angle", "length", "in 1.96", "sigmas"]
    table = []
    for row, record in zip(rows, records, strict=True):
        cells = [_knob(record[name]) for name in swept] + [str(row.segments)]
        found = row.evaluation
        if found is None:
            table.append(cells + ["-"] * (len(head) - len(cells)))
            continue
        cells += [
            str(len(found.lines)),
            _number(found.distance_mm.median, 3),
            _number(found.distance_mm.at_95, 3),
            *(_number(share, 3) for share in (found.precision[0], found.precision[-1])),
            *(_number(share, 3) for share in (found.completeness[0], found.completeness[-1])),
            _number(found.angle_deg.median, 3),
            _number(found.length_error_mm.median, 3),
            _number(found.normalised.share_within, 3),
            _number(found.normalised.spread, 2),
        ]
        table.append(cells)
    return head, table


def _knob(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _number(value: float, decimals: int) -> str:
    text = with_decimals(value, decimals)
    return "-" if text == "not known" else text
