"""Features in space of any kind: as lines to turn, as a table, and in words."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from trinoc.geometry import Feature, Rig
from trinoc.match import Wireframe
from trinoc.report.numbers import in_words, with_decimals, with_sigma
from trinoc.report.space_content import Box
from trinoc.report.space_part import Layer, SpaceFigure, View, cameras_in_space
from trinoc.report.wireframe_part import wireframe_layers

# Room about the features, as a share of their extent.
ROOM = 0.1
_UNITS = ("mm", "px")


def features_figure(features: Feature, rig: Rig | None = None) -> SpaceFigure:
    """The features, and the cameras of `rig`."""
    figure = SpaceFigure(tuple(features_layers(features)), (), ())
    if rig is not None:
        figure = figure.joined(cameras_in_space(rig))
    places = features.wires().places_mm
    if len(places) == 0:
        return figure
    name = features.IN_WORDS.removeprefix("a ").capitalize()
    return figure._replace(views=(View(name, Box.around(places, ROOM)),))


def with_features(figure: SpaceFigure, kinds: Iterable[Feature]) -> SpaceFigure:
    """A figure of the segments, and features in it."""
    more = tuple(layer for features in kinds for layer in features_layers(features))
    return figure.joined(SpaceFigure(more, (), ()))


def features_layers(features: Feature) -> list[Layer]:
    """One layer of the lines of all of them, with words; a wire frame has more."""
    if isinstance(features, Wireframe):
        return wireframe_layers(features)
    if not len(features):
        return []
    rows, lines = zip(*features.wires().lines(), strict=True)
    words = tuple(feature_words(features, row) for row in rows)
    name = f"{features.IN_WORDS} ({len(features)})"
    return [Layer(name, "joined", list(lines), True, (), words)]


def feature_words(features: Feature, row: int) -> str:
    """What is known of one of them: its numbers with their sigmas, and where it is seen."""
    numbers = [f"{name} {value}" for name, value in feature_numbers(features, row).items()]
    seen = "; ".join(
        f"{view} {', '.join(map(str, own.tolist()))}"
        for view, own in features.segments_of(row).items()
        if len(own)
    )
    whole = ", ".join([*numbers, *([f"segments {seen}"] if seen else [])])
    return f"{features.KIND.removesuffix('s')} {row}: {whole}"


def feature_numbers(features: Feature, row: int) -> dict[str, str]:
    """By name, what people read first of a feature."""
    found = {}
    for column in features.READ_FIRST:
        stem, unit = _unit_of(column)
        value = np.asarray(getattr(features, column))[row]
        sigma = getattr(features, f"{stem}_sigma{unit and '_' + unit}", None)
        text = with_decimals(float(value), 3)
        text = text if sigma is None else with_sigma(float(value), float(sigma[row]))
        found[in_words(stem)] = f"{text} {unit}".strip()
    return found


def feature_table(features: Feature) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """(head, rows) of a table of them."""
    numbers = [feature_numbers(features, row) for row in range(len(features))]
    head = (features.KIND.removesuffix("s"), *(numbers[0] if numbers else ()), "segments")
    counts = [sum(map(len, features.segments_of(row).values())) for row in range(len(features))]
    return head, [(str(k), *own.values(), str(counts[k])) for k, own in enumerate(numbers)]


def features_text(features: Feature) -> str:
    """A sentence, and a line for each, for people."""
    lines = [feature_words(features, row) for row in range(len(features))]
    return "\n".join([features.summary(), *(lines if features.READ_FIRST else [])])


def features_record(features: Feature) -> dict[str, Any]:
    """What programs want to know of them, as JSON can hold it."""
    own: dict[str, Any] = {}
    if features.READ_FIRST:
        columns = {
            name: np.asarray(column)
            for name, column in features.rows().items()
            if "covariance" not in name
        }
        columns |= {name: np.asarray(getattr(features, name)) for name in features.DERIVED}
        own["found"] = [
            {name: column[row].tolist() for name, column in columns.items()}
            | {"segments": {v: s.tolist() for v, s in features.segments_of(row).items()}}
            for row in range(len(features))
        ]
    return {**own, **features.record()}


def _unit_of(column: str) -> tuple[str, str]:
    stem, _, last = column.rpartition("_")
    return (stem, last) if last in _UNITS else (column, "")
