"""Judgements in words, for a terminal and a page."""

import math
from collections.abc import Sequence

from trinoc.capture.advice import field_share, next_step
from trinoc.capture.judgement import Judgement


def judgement_line(judgement: Judgement) -> str:
    """One line: what was found, sharpness, exposure, and what is wrong."""
    name = " ".join(judgement.name.split())
    if not judgement.found:
        perhaps = f" Perhaps because {'; '.join(judgement.faults)}." if judgement.faults else ""
        return f"{name}: NOT FOUND, {judgement.refusal}{perhaps}"
    verdict = "good" if judgement.good else "AGAIN"
    parts = [
        f"{len(judgement.places_px)} of {judgement.of_places} {judgement.kind}",
        f"edges {_number(judgement.blur_px)} px",
        f"saturated {judgement.exposure.saturated:.1%}, dark {judgement.exposure.dark:.1%}",
        *judgement.faults,
    ]
    return f"{name}: {verdict}, {'; '.join(parts)}"


def summary_lines(judgements: Sequence[Judgement]) -> list[str]:
    """How many pictures are good, what they cover, and what to do next."""
    good = sum(judgement.good for judgement in judgements)
    lost = sum(not judgement.found for judgement in judgements)
    counts = f"{len(judgements)} pictures: {good} good, {lost} without the board found, "
    counts += f"{len(judgements) - good - lost} to take again"
    return [f"{counts}; {field_share(judgements):.0%} of the field covered.", next_step(judgements)]


def _number(value: float) -> str:
    return "?" if math.isnan(value) else f"{value:.1f}"
