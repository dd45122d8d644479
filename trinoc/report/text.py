"""Results as tables for a terminal."""

from collections.abc import Sequence

import numpy as np

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
