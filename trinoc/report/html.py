"""The report: one HTML page that holds its pictures, its script and its style in itself."""

import functools
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jinja2
import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.result.summary import fixed_boards
from trinoc.calib.starts.pictures import Pictures
from trinoc.errors import InputError, list_names
from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io.atomic import write_text
from trinoc.match.tracks.matches import Matches
from trinoc.report.calibration_part import cameras_part, cameras_part_of_shots, sheet_part
from trinoc.report.checks import Subject
from trinoc.report.coverage import (
    coverage_by_boards,
    coverage_by_circles,
    mean_residuals,
    places_seen,
)
from trinoc.report.epipolar_part import (
    EpipolarPart,
    corrected_circle_centres,
    ends_of_tracks,
    epipolar_part,
)
from trinoc.report.features_part import feature_table, with_features
from trinoc.report.field_part import field_part, halves_maps, uncertainty_maps
from trinoc.report.frames_part import FramesPart
from trinoc.report.matches_part import matches_part
from trinoc.report.parameter_table import is_without_sheet
from trinoc.report.pictures import PagePicture, page_pictures
from trinoc.report.report_table import ReportTable, draw_code, draw_table
from trinoc.report.shot_images_part import shot_images_part
from trinoc.report.shots_part import boards_in_space, shot_table
from trinoc.report.space_content import Box
from trinoc.report.space_part import SpaceFigure, SpaceView, draw_plans, space_figure
from trinoc.report.verdict import Verdict, find_verdict


class ReportPart(NamedTuple):
    """Section of the page.

    Attributes
    ----------
    anchor : str
        Identifier of the section in links.
    title : str
        Heading.
    template : str
        Name of the template that draws the section.
    values : object
        Values that the template shows.
    """

    anchor: str
    title: str
    template: str
    values: Any


class ExtraTable(NamedTuple):
    """Additional table of the page, such as a score against a known truth.

    Attributes
    ----------
    title : str
        Heading.
    head : sequence of str
        Names of the columns.
    rows : sequence of sequence of str
        Cells of each row.
    caption : str
        Sentence above the table.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


def write_report(
    path: str | os.PathLike[str],
    *,
    result: CalibrationResult | None = None,
    shot_pictures: Mapping[str, Pictures] | None = None,
    sheet_pictures: Mapping[str, np.ndarray] | None = None,
    rig: Rig | None = None,
    segments: Mapping[str, Segments] | None = None,
    matches: Matches | None = None,
    scene_pictures: Mapping[str, np.ndarray] | None = None,
    reference: Rig | None = None,
    reference_name: str = "reference",
    title: str = "trinoc report",
    tables: Sequence[ExtraTable] = (),
    provenance: Mapping[str, str] | None = None,
    doubts: Mapping[str, str] | None = None,
    features: Sequence[Feature] = (),
    advice: str = "",
    recording: FramesPart | None = None,
) -> None:
    """Write a self-contained HTML page about a calibration, a matching, or both.

    The page has a section for each kind of argument that is given. It needs no network, and equal
    inputs give equal bytes. The file is complete or absent.

    Parameters
    ----------
    path : path
        File to write.
    result : CalibrationResult, optional
        Result of `calibrate`, or of `calibrate_rig`. The latter cannot be combined with matches. If
        it failed, the page shows its shots and residuals only.
    shot_pictures : mapping of camera to images, optional
        Images that were given to `calibrate_rig`; residuals are drawn on them. Images may be
        functions that return an image; at most 12 per camera are called.
    sheet_pictures : mapping of camera to (h, w) or (h, w, channels), optional
        Images that were given to `calibrate`.
    rig : Rig, optional
        Cameras of `matches` and `segments`; by default those of `result`.
    segments : mapping of view to Segments, optional
        Segments that were matched.
    matches : Matches, optional
        Matches. Cameras of the rig without a view are omitted, with a note on the page.
    scene_pictures : mapping of view to (h, w) or (h, w, channels), optional
        Images in which the segments were found.
    reference : Rig, optional
        Known cameras to compare with the estimated ones.
    reference_name : str
        Name of `reference` on the page.
    title : str
        Title of the page.
    tables : sequence of ExtraTable
        Additional tables, shown after the matches.
    provenance : mapping of str to str, optional
        Names and values at the end of the page, such as command, version and files.
    doubts : mapping of camera to str, optional
        Reason for each camera of `rig` whose calibration was suspect.
    features : sequence of Feature
        Features of the matches, such as joined lines, shown in space and in tables.
    advice : str
        Sentence on the next shot, for a result of `calibrate_rig`.
    recording : FramesPart, optional
        All frames of a recording; `matches` are those of its middle frame.

    Raises
    ------
    InputError
        If there is no rig, calibration or segments, if the rig lacks a camera of the segments or
        matches, if a result of `calibrate_rig` is combined with matches, or if the file cannot be
        written.
    """
    content = {name: value for name, value in locals().items() if name != "path"}
    write_text(path, render_report(**content))


def render_report(
    *,
    result: CalibrationResult | None = None,
    shot_pictures: Mapping[str, Pictures] | None = None,
    sheet_pictures: Mapping[str, np.ndarray] | None = None,
    rig: Rig | None = None,
    segments: Mapping[str, Segments] | None = None,
    matches: Matches | None = None,
    scene_pictures: Mapping[str, np.ndarray] | None = None,
    reference: Rig | None = None,
    reference_name: str = "reference",
    title: str = "trinoc report",
    tables: Sequence[ExtraTable] = (),
    provenance: Mapping[str, str] | None = None,
    doubts: Mapping[str, str] | None = None,
    features: Sequence[Feature] = (),
    advice: str = "",
    recording: FramesPart | None = None,
) -> str:
    """Return the page that `write_report` writes, as text. The arguments are the same."""
    if result is not None and result.views:
        if matches is not None or segments:
            raise InputError(
                "A report on many shots contains nothing else: write a second report for the rest."
            )
        parts, subject = _parts_of_shots(result, advice)
        images = shot_images_part(result, shot_pictures)
        if images is None:
            return _render(title, parts, subject, provenance)
        anchors = [part.anchor for part in parts]
        title_of_images = "Residuals of each shot on its image"
        row = anchors.index("shots") + 1
        parts.insert(row, ReportPart("shot-images", title_of_images, "shot_images", images))
        return _render(title, parts, subject, provenance, images.pictures)
    rig = rig if rig is not None else (result.rig if result is not None else None)
    if rig is None:
        raise InputError("A report needs a rig or a calibration: give at least one of them.")
    views = matches.views if matches is not None else tuple(segments or {})
    _check_views("segments" if matches is None else "matches", views, rig)
    scene_rig, cameras_without_view = rig.take(views or rig.names), ()
    if result is None:
        cameras_without_view = tuple(name for name in rig if name not in scene_rig.names)
        rig = scene_rig
    sizes = {name: camera.image_size_px for name, camera in rig.items()}
    if result is not None:
        sizes |= {name: fit.detection.image_size_px for name, fit in result.fits.items()}
    sheet = page_pictures("sheet", sheet_pictures, sizes)
    scene = page_pictures("scene", scene_pictures, sizes)
    pattern = result.pattern if result is not None else None
    subject = Subject(
        result=result,
        matches=matches,
        doubts=doubts or {},
        coverage=() if result is None else coverage_by_circles(result, sheet),
        epipolar=_epipolar_parts(scene_rig, result, matches, sheet, scene),
        field=field_part(rig, pattern, matches, sheet if result is not None else scene),
        recording=recording,
    )
    parts = []
    if recording is not None:
        parts.append(ReportPart("recording", "All frames", "recording", recording))
    cameras = cameras_part(rig, result, reference, reference_name, cameras_without_view)
    parts.append(ReportPart("cameras", "Cameras", "cameras", cameras))
    if result is not None and result.fits:
        values = sheet_part(result, subject.coverage, sheet)
        parts.append(ReportPart("detection", "The sheet: coverage and residuals", "sheet", values))
    if subject.field is not None:
        parts.append(ReportPart("field", "Uncertainty over the field", "field", subject.field))
    if subject.epipolar:
        parts.append(ReportPart("epipolar", "Epipolar check", "epipolar", subject.epipolar))
    if segments or matches is not None:
        section = matches_part(views, segments or {}, matches, scene)
        if section.segments:
            parts.append(ReportPart("segments", "Segments found", "segments", section))
        if matches is not None:
            parts.append(ReportPart("matches", "Matched segments", "matches", section))
            parts.append(ReportPart("counts", "Counts, and why not", "counts", section))
    listed_features = [each for each in features if each.READ_FIRST]
    titled_tables = [(each.IN_WORDS.capitalize(), feature_table(each)) for each in listed_features]
    titled_tables += [(t.title, ReportTable(t.head, t.rows, note=t.caption)) for t in tables]
    for number, (heading, table) in enumerate(titled_tables, 1):
        parts.append(ReportPart(f"table-{number}", heading, "table", table))
    space = space_figure(rig, pattern, matches)
    parts.append(_space_part(with_features(space, features), tracks=matches is not None))
    pictures = [picture for picture in (*sheet.values(), *scene.values()) if picture.uri]
    world = "" if is_without_sheet(rig) else " with Z up out of the sheet"
    return _render(title, parts, subject, provenance, pictures, world)


def judge_shots(shots: CalibrationResult) -> Verdict | None:
    """Verdict on a rig from many shots, as shown at the top of its report."""
    return find_verdict(_parts_of_shots(shots, "")[1])


def _parts_of_shots(shots: CalibrationResult, advice: str) -> tuple[list[ReportPart], Subject]:
    points = places_seen(shots)
    coverage, (residuals, arrows) = coverage_by_boards(points), mean_residuals(points)
    subject = Subject(
        shots=shots,
        coverage=coverage,
        residuals=residuals,
        uncertainty=uncertainty_maps(shots),
    )
    table = {"result": shots, "table": shot_table(shots), "advice": advice}
    table["fixed_boards"] = fixed_boards(shots)
    parts = [
        ReportPart("cameras", "Lenses and cameras", "cameras", cameras_part_of_shots(shots)),
        ReportPart("shots", "Shots", "shots", table),
    ]
    if coverage:
        values = {"coverage": coverage, "residuals": residuals, "arrows": arrows}
        title = "Places and residuals over the field"
        parts.append(ReportPart("field-of-board", title, "places", values))
    halves = halves_maps(shots)
    if halves:
        parts.append(
            ReportPart("halves", "Two halves of the shots over the field", "halves", halves)
        )
    if subject.uncertainty is not None:
        title = "Uncertainty over the field"
        parts.append(ReportPart("uncertainty", title, "uncertainty", subject.uncertainty))
    if shots.has_rig:
        parts.append(_space_part(boards_in_space(shots, shots.rig), tracks=False))
    return parts, subject


def _epipolar_parts(
    rig: Rig,
    result: CalibrationResult | None,
    matches: Matches | None,
    sheet: Mapping[str, PagePicture],
    scene: Mapping[str, PagePicture],
) -> tuple[EpipolarPart, ...]:
    parts = []
    if result is not None:
        points = corrected_circle_centres(result)
        parts.append(epipolar_part("sheet", "circles", result.rig, points, sheet))
    if matches is not None:
        in_rig_order = ends_of_tracks(matches)[:, [matches.views.index(name) for name in rig]]
        parts.append(epipolar_part("scene", "ends of tracks", rig, in_rig_order, scene))
    return tuple(part for part in parts if part is not None)


def _space_part(figure: SpaceFigure, *, tracks: bool) -> ReportPart:
    values = {
        "figure": figure,
        "numbers": figure.numbers(),
        "plans": draw_plans(figure),
        "tracks": tracks,
    }
    return ReportPart("space", "In space", "space", values)


def render_space(figure: SpaceFigure, *, title: str) -> str:
    """Return a page that contains only the interactive 3-D figure."""
    if not figure.views:
        view = SpaceView("Nothing", Box.around(np.zeros((1, 3)), 0.5))
        figure = figure._replace(views=(view,))
    tracks = any(layer.tracks for layer in figure.layers)
    return _render(title, [_space_part(figure, tracks=tracks)], Subject(), None)


def _render(
    title: str,
    parts: Sequence[ReportPart],
    subject: Subject,
    provenance: Mapping[str, str] | None,
    pictures: Sequence[PagePicture] = (),
    world: str = "",
) -> str:
    """Return the HTML of the page. All texts are escaped, so no text of a user becomes markup."""
    return (
        _templates()
        .get_template("page.html.j2")
        .render(
            title=title,
            verdict=find_verdict(subject),
            parts=parts,
            pictures=pictures,
            provenance=dict(provenance or {}),
            world=world,
        )
    )


@functools.cache
def _templates() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("trinoc.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = draw_code
    environment.globals["draw_table"] = draw_table
    return environment


def _check_views(what: str, names: Sequence[str], rig: Rig) -> None:
    if not set(names) <= set(rig.names):
        raise InputError(
            f"The views of the {what} are {list_names(names)}, but the cameras of the rig are "
            f"{list_names(rig)}: give the rig that belongs to the {what}."
        )
