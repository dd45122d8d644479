"""The page: self-contained, complete, safe against names, equal for equal inputs."""

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from trinoc.calib import CalibrationResult, Status
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.report import write_report
from trinoc.report.html import ExtraTable, render_report
from trinoc.report.notebook.tables import list_columns
from trinoc.report.numbers import with_sigma
from trinoc.report.space_part import space_figure

from .conftest import PARAMETERS, made_up_matches, made_up_result, made_up_rig

VOID = {"meta", "link", "input", "br", "img", "hr"}


class Page(HTMLParser):
    """Attributes and text of a page; asserts that every element is closed where it was opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] not in ("script", "style"):
            self.words.append(data)

    def attributes(self, name: str) -> list[str]:
        return [value for _, attrs in self.elements if (value := attrs.get(name)) is not None]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def page_html(
    result: CalibrationResult,
    sheet_pictures: dict[str, np.ndarray],
    segments: dict[str, Segments],
    matches: Matches,
    scene_pictures: dict[str, np.ndarray],
) -> str:
    return render_report(
        result=result,
        sheet_pictures=sheet_pictures,
        segments=segments,
        matches=matches,
        scene_pictures=scene_pictures,
        reference=result.rig,
        reference_name="Table 1",
        tables=[ExtraTable("Score", ("measure", "value"), [("precision", "0.97")])],
    )


def test_nothing_on_the_page_comes_from_elsewhere(page_html: str) -> None:
    page = Page(page_html)
    for name in ("src", "href", "action", "data", "poster", "srcset"):
        for value in page.attributes(name):
            assert value.startswith(("#", "data:")), value[:80]
    styles = "".join(re.findall(r"<style>(.*?)</style>", page_html, flags=re.DOTALL))
    assert "url(" not in styles
    assert "@import" not in styles
    (policy,) = [v for v in page.attributes("content") if "default-src" in v]
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_every_camera_and_parameter_is_shown_with_its_sigma(page_html: str, rig: Rig) -> None:
    page = Page(page_html)
    assert page.attributes("data-parameter").__len__() == len(rig) * len(PARAMETERS)
    assert set(page.attributes("data-parameter")) == set(rig.parameters)
    for value in ("2.1430 ± 0.0013", "53.25200 ± 0.00080", "476.3690 ± 0.0045", "0.8720 ± 0.0011"):
        assert value in page.text


def test_every_circle_and_track_is_drawn_in_every_view(
    page_html: str, result: CalibrationResult, matches: Matches
) -> None:
    page = Page(page_html)
    circles = [c for c in page.attributes("class") if c.split()[0] == "circle"]
    assert len(circles) == sum(len(fit.detection) for fit in result.fits.values())
    assert "circle unused" in circles
    strokes = [a for tag, a in page.elements if tag == "g" and "--ink" in (a.get("style") or "")]
    assert len(strokes) == int((matches.index >= 0).sum())


def test_a_track_has_one_colour_everywhere(page_html: str, matches: Matches) -> None:
    inks: dict[str | None, set[str | None]] = {}
    for tag, attributes in Page(page_html).elements:
        if tag == "g" and "--ink" in (attributes.get("style") or ""):
            inks.setdefault(attributes["data-track"], set()).add(attributes.get("style"))
    assert len(inks) == len(matches)
    assert all(len(styles) == 1 for styles in inks.values())


def test_counts_and_reasons_are_shown(page_html: str, matches: Matches) -> None:
    text = Page(page_html).text
    for name, count in matches.counts.items():
        assert f"{name.replace('_', ' ')} {count}" in text
    assert "no partner in the zone 9 8 9" in text
    assert "Score" in text
    assert "precision 0.97" in text


def test_three_pictures_of_a_quarter_megapixel_stay_small(page_html: str) -> None:
    assert len(page_html) < 1_000_000


def test_a_segment_and_its_track_are_linked(page_html: str, matches: Matches) -> None:
    """In the figure of all segments a matched one carries its track, the others are dashed."""
    strokes = [a for tag, a in Page(page_html).elements if tag == "g" and "data-words" in a]
    segments = [a for a in strokes if (a["data-words"] or "").startswith("segment")]
    unmatched = [a for a in segments if "unmatched" in (a["class"] or "")]
    on_tracks = [a for a in segments if "data-track" in a]
    assert len(on_tracks) == int((matches.index >= 0).sum())
    assert len(unmatched) == len(segments) - len(on_tracks) > 0


def test_the_notes_of_a_camera_are_shown(page_html: str) -> None:
    assert "Circle 7 was left out as an outlier." in Page(page_html).text


def test_equal_inputs_give_equal_pages(
    result: CalibrationResult, sheet_pictures: dict[str, np.ndarray]
) -> None:
    first = render_report(result=result, sheet_pictures=sheet_pictures)
    second = render_report(result=result, sheet_pictures=sheet_pictures)
    assert first == second


def test_a_calibration_alone_has_no_matches(
    result: CalibrationResult, sheet_pictures: dict[str, np.ndarray]
) -> None:
    ids = Page(render_report(result=result, sheet_pictures=sheet_pictures)).attributes("id")
    assert {"verdict", "cameras", "detection", "field", "epipolar", "space"} <= set(ids)
    assert not {"segments", "matches", "counts"} & set(ids)


def test_matches_alone_have_no_detection(
    rig: Rig,
    segments: dict[str, Segments],
    matches: Matches,
    scene_pictures: dict[str, np.ndarray],
) -> None:
    page = Page(
        render_report(rig=rig, segments=segments, matches=matches, scene_pictures=scene_pictures)
    )
    assert {"cameras", "epipolar", "segments", "matches", "counts"} <= set(page.attributes("id"))
    assert "detection" not in page.attributes("id")


def test_pages_without_pictures_or_segments_stand(
    rig: Rig, result: CalibrationResult, matches: Matches
) -> None:
    assert "picture-sheet" not in render_report(result=result)
    assert "segments" not in Page(render_report(rig=rig, matches=matches)).attributes("id")
    assert "cameras" in Page(render_report(rig=rig)).attributes("id")


def test_no_matches_at_all_are_a_page_too(rig: Rig, segments: dict[str, Segments]) -> None:
    reasons = {
        name: np.full(len(view_segments), "no_partner") for name, view_segments in segments.items()
    }
    none = Matches(
        rig.names,
        np.zeros((0, 3), dtype=np.int64),
        np.zeros((0, 3, 2, 2)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 6, 6)),
        np.zeros(0, dtype="<U10"),
        np.zeros(0),
        np.zeros(0),
        reasons,
        {"candidates": 0},
    )
    text = Page(render_report(rig=rig, segments=segments, matches=none)).text
    assert "Seen in three or more views: 0 tracks" in text
    assert "no partner 42 42 42" in text


def test_names_cannot_break_the_page() -> None:
    name = '</script><img src=x onerror="alert(1)">&\'{{7*7}}'
    rig = made_up_rig()
    renamed = Rig(dict(zip((name, "b", "c"), rig.cameras, strict=True)))
    segments, matches = made_up_matches(renamed)
    text = render_report(rig=renamed, segments=segments, matches=matches, title=name)
    page = Page(text)
    assert "onerror" not in [key for _, attributes in page.elements for key in attributes]
    assert "<img" not in text
    assert name in page.words
    assert "49" not in re.findall(r"<h1>(.*?)</h1>", text)[0]


def test_the_figure_in_space_holds_every_track_once(page_html: str, matches: Matches) -> None:
    (store,) = re.findall(
        r'<script type="application/json" id="space-numbers">(.*?)</script>', page_html
    )
    figure = json.loads(store)
    three, two = (layer for layer in figure["layers"] if layer["role"] in ("three", "two"))
    assert sorted(three["tracks"] + two["tracks"]) == list(range(len(matches)))
    for layer in (three, two):
        for track, part in zip(layer["tracks"], layer["parts"], strict=True):
            np.testing.assert_allclose(part, matches.lines_mm[track].ravel(), atol=6e-4)
    legend = Page(page_html).text
    for label in ("three or more views (28)", "two views (8)", "cameras", "sheet"):
        assert label in legend
    assert len(Page(page_html).attributes("data-layer")) == len(figure["layers"])


def test_words_in_space_tell_both_ends_and_their_sigmas(rig: Rig, matches: Matches) -> None:
    (two,) = [layer for layer in space_figure(rig, None, matches).layers if layer.role == "two"]
    track, description = two.tracks[1], two.descriptions[1]
    assert description.startswith(f"track {track}, binocular")
    for point in matches.lines_mm[track]:
        assert f"X {with_sigma(float(point[0]), 0.2)}" in description
    assert "sigma across" in description


def test_joined_lines_and_corners_can_be_shown(rig: Rig, matches: Matches) -> None:
    roles = [layer.role for layer in space_figure(rig, None, matches).layers]
    assert "corners" not in roles
    covariance = np.tile(0.04 * np.eye(4), (*matches.index.shape, 1, 1))
    located = dataclasses.replace(
        matches,
        fragments_covariance_px2=covariance,
        viewpoint_dependent=np.arange(len(matches)) == 2,
    )
    layers = {layer.role: layer for layer in space_figure(rig, None, located).layers}
    assert not layers["joined"].shown
    corners = layers["corners"]
    assert len(corners.parts) == len(corners.descriptions) > 0
    assert "mm" in corners.descriptions[0]
    assert Page(render_report(rig=rig, matches=located)).text.count("moves") == 1


def test_lens_distortion_bends_the_epipolar_lines_through_their_points() -> None:
    rig = made_up_rig(distortion=(-0.25, 0.1, 0.001, -0.0005, 0.0))
    _, matches = made_up_matches(rig)
    page = Page(render_report(rig=rig, matches=matches))
    curves = [a["points"] for tag, a in page.elements if tag == "polyline"]
    assert curves
    assert all(curve is not None and len(curve.split()) > 2 for curve in curves)
    assert "rms: upper and right 0.000 px" in page.text


def test_the_file_is_whole_or_not_there(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "report.html"
    write_report(path, rig=rig)
    assert path.read_text(encoding="utf-8") == render_report(rig=rig)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(InputError, match="does not exist"):
        write_report(tmp_path / "none" / "report.html", rig=rig)


def test_what_cannot_be_shown_is_refused(
    rig: Rig, segments: dict[str, Segments], matches: Matches
) -> None:
    with pytest.raises(InputError, match="needs a rig or a calibration"):
        render_report(segments=segments)
    other = Rig(dict(zip(("a", "b", "c"), rig.cameras, strict=True)))
    with pytest.raises(InputError, match="views of the matches"):
        render_report(rig=other, matches=matches)
    with pytest.raises(InputError, match="views of the segments"):
        render_report(rig=other, segments=segments)


def test_cameras_without_a_view_are_left_out_with_one_note(
    rig: Rig, segments: dict[str, Segments], matches: Matches, result: CalibrationResult
) -> None:
    more = {f"camera {k}": rig.cameras[0] for k in range(40)}
    larger = Rig(
        {**more, **dict(rig.items())}, parameters=rig.parameters, covariance=rig.covariance
    )
    scene = {"segments": segments, "matches": matches}
    note = (
        " Cameras without a view of this scene are left out: camera 0, camera 1, camera 2, "
        "camera 3, camera 4, camera 5 and 34 more."
    )
    page = render_report(rig=larger, **scene)
    assert note in page
    assert page.replace(note, "") == render_report(rig=rig, **scene)
    # A calibration shows all its cameras, and a scene those of its views.
    some = matches.views[:2]
    pair = dataclasses.replace(
        matches.take(np.flatnonzero((matches.index[:, :2] >= 0).all(axis=1))),
        views=some,
        reasons={name: matches.reasons[name] for name in some},
    )
    two = [getattr(pair, name)[:, :2] for name in ("index", "fragments_px")]
    stage = np.full(len(pair), "binocular")
    pair = dataclasses.replace(pair, index=two[0], fragments_px=two[1], stage=stage)
    text = Page(render_report(result=result, matches=pair)).text
    assert "3 of 3 cameras calibrated" in text
    assert "left out:" not in text


def test_cameras_of_a_world_without_a_sheet_have_a_place_and_a_direction(rig: Rig) -> None:
    turns = (np.eye(3), np.diag([1.0, -1.0, -1.0]), np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]))
    centres = np.array([[1000.0, -2000.0, 500.0], [1.5, 2.5, 3.5], [-7.0, 8.0, 9.0]])
    office = Rig(
        {
            name: Camera(rig[name].intrinsics, Pose.from_centre(turn, centre))
            for name, turn, centre in zip(rig, turns, centres, strict=True)
        }
    )
    text = Page(render_report(rig=office)).text
    assert "not known" not in text.replace("sigmas are unknown", "")
    for axis, values in zip("XYZ", centres.T, strict=True):
        row = " ".join(f"{value:.2f}".replace("-", "\N{MINUS SIGN}") for value in values)
        assert f"position {axis} (mm) {row}" in text
    assert "viewing direction Z 1.0000 \N{MINUS SIGN}1.0000 0.0000" in text
    assert "Z up out of the sheet" not in text
    table = list_columns(office)
    value_of = dict(
        zip(zip(table["camera"], table["parameter"], strict=True), table["value"], strict=True)
    )
    for (name, camera), turn in zip(office.items(), turns, strict=True):
        direction = [value_of[name, f"direction_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(direction, turn[2])
        position = [value_of[name, f"position_{axis}_mm"] for axis in "xyz"]
        np.testing.assert_allclose(position, camera.centre_world_mm)
        assert ("centre_world_mm=" in repr(camera)) == (not np.isfinite(camera.distance_mm))
    # Over a sheet nothing changes.
    assert "position X" not in Page(render_report(rig=rig)).text
    assert "distance (mm)" in Page(render_report(rig=rig)).text


def test_a_camera_that_failed_says_why() -> None:
    result = made_up_result(made_up_rig())
    fits = {name: fit for name, fit in result.fits.items() if name != "left"}
    names = ("upper", "right")
    failed = CalibrationResult(
        Rig({name: result.rig[name] for name in names}),
        {**result.status, "left": next(s for s in Status if s is not Status.CONVERGED)},
        (),
        np.zeros(0),
        np.zeros((0, 0)),
        fits,
        result.pattern,
        {"left": "No sheet was found in this picture."},
    )
    text = Page(render_report(result=failed)).text
    assert "2 of 3 cameras calibrated" in text
    assert "No sheet was found in this picture." in text
    assert "✗ not a result" in text
    assert "Do not rely on this rig." in text
