"""Values in a notebook: a table and a picture, axes to build on, figures, frames."""

import json
import re
from html.parser import HTMLParser
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import trinoc
from trinoc.calib import CalibrationResult, RefineResult
from trinoc.calib.bundle.result import RefineStatus
from trinoc.errors import InputError
from trinoc.evaluation.evaluation import Evaluation, evaluate
from trinoc.geometry import LineObservations, UncertainLines
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.display import Displayable
from trinoc.report.html import render_report
from trinoc.report.notebook import axes, cards
from trinoc.report.notebook.tables import list_columns

mpl.use("agg")


def test_every_value_that_shows_itself_can() -> None:
    doors = (trinoc, trinoc.calib, trinoc.match)
    handed_on = [getattr(door, name) for door in doors for name in door.__all__]
    kinds = [kind for kind in handed_on if isinstance(kind, type)]
    shown = {kind for kind in kinds if issubclass(kind, Displayable)}
    assert len(shown) >= 5
    for verb in (axes._plot, cards.heading, list_columns):
        assert {kind for kind in shown if verb.dispatch(kind) is verb.dispatch(object)} == set()


@pytest.fixture(scope="module")
def refined(rig: Rig, matches: Matches) -> RefineResult:
    count = len(matches)
    return RefineResult(
        RefineStatus.CONVERGED,
        rig,
        rig.parameters,
        np.zeros(len(rig.parameters)),
        np.asarray(rig.covariance),
        UncertainLines(
            np.asarray(matches.lines_mm),
            np.asarray(matches.covariance_mm2),
            np.zeros((count, 6, len(rig.parameters))),
            np.asarray(rig.covariance),
        ),
        matches.index >= 0,
        np.where(matches.index >= 0, 0.5, np.nan),
        12,
        "",
        1.0,
        1.0,
        0.0,
        (1.0, 2.0),
        0.0,
        (0.0,),
        LineObservations(
            matches.views,
            matches.fragments_px,
            np.tile(np.eye(4), (*matches.index.shape, 1, 1)),
            matches.index >= 0,
            matches.lines_mm,
        ),
    )


@pytest.fixture(scope="module")
def evaluation(matches: Matches) -> Evaluation:
    return evaluate(matches, matches.lines_mm)


@pytest.fixture(scope="module")
def values(
    rig: Rig,
    result: CalibrationResult,
    segments: dict[str, Segments],
    matches: Matches,
    refined: RefineResult,
    evaluation: Evaluation,
) -> list[Any]:
    return [rig, result, result.pattern, segments["upper"], matches, refined, evaluation]


class _Balanced(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_card_has_a_table_and_a_picture_and_is_small(values: list[Any]) -> None:
    for value in values:
        card = value._repr_html_()
        _Balanced(card)
        assert type(value).__name__ in card
        assert "<table>" in card
        assert ("<svg" in card) == (not isinstance(value, Evaluation))
        assert len(card) < 60_000


def test_names_cannot_break_a_card(rig: Rig) -> None:
    card = Rig(dict(zip(("<b>", "b", "c"), rig.cameras, strict=True)))._repr_html_()
    _Balanced(card)
    assert "&lt;b&gt;" in card


def test_a_plot_is_made_of_axes_and_uses_those_given(values: list[Any]) -> None:
    for value in values:
        drawn = value.plot()
        first = drawn[0] if isinstance(drawn, np.ndarray) else drawn
        assert first.has_data() or first.collections
        if not isinstance(drawn, np.ndarray):
            figure = plt.figure()
            plot_axes = figure.add_subplot(projection="3d" if first.name == "3d" else None)
            assert value.plot(plot_axes) is plot_axes
    plt.close("all")


def test_tracks_are_drawn_on_a_picture_too(matches: Matches) -> None:
    axes = matches.plot(view="left")
    three = (matches.stage == "trinocular").sum()
    assert len(axes.collections[0].get_segments()) == three
    plt.close("all")


def numbers_of(page: str) -> dict[str, Any]:
    """The numbers of the figure on a page."""
    match = re.search(r'<script type="application/json" id="space-numbers">(.*?)</script>', page)
    assert match is not None
    return json.loads(match[1])


def test_the_figure_to_turn_is_that_of_the_report(
    values: list[Any], rig: Rig, matches: Matches
) -> None:
    for value in values:
        if isinstance(value, Segments | Evaluation):
            with pytest.raises(TypeError, match="use plot"):
                value.show()
            continue
        shown = value.show()
        assert any(layer["parts"] for layer in numbers_of(shown.html)["layers"])
        assert "<iframe" in shown._repr_html_()
        assert '"use strict"' not in shown._repr_html_()
    report = render_report(rig=rig, matches=matches)
    assert numbers_of(matches.show(rig=rig).html) == numbers_of(report)


def test_a_frame_has_a_row_for_each_item(values: list[Any], matches: Matches) -> None:
    pytest.importorskip("pandas")
    rig, result, pattern, segments, _, refined, evaluation = (value.to_frame() for value in values)
    assert len(rig) == len(result) == 12
    assert set(result["status"]) == {"CONVERGED"}
    assert rig.set_index(["camera", "parameter"]).loc[("left", "tilt_deg"), "sigma"] == 0.0008
    assert len(refined) == 12
    assert len(evaluation) == 1
    assert len(pattern) == 36
    assert len(segments) == 42
    frame = matches.to_frame()
    np.testing.assert_allclose(
        frame[["x1_mm", "y1_mm", "z1_mm"]].to_numpy(), matches.lines_mm[:, 0]
    )
    assert (frame["length_sigma_mm"] > 0).all()


def test_a_missing_library_is_named_with_its_extra(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for ask, extra in ((rig.plot, "plot"), (rig.to_frame, "notebook")):
        with pytest.raises(InputError, match=rf"pip install 'trinoc\[{extra}\]'"):
            ask()
