"""The report: one HTML page that holds its pictures, its script and its style in itself."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trinoc.calib import CalibrationResult
from trinoc.errors import InputError
from trinoc.geometry import Feature, Rig, Segments
from trinoc.io import write_text
from trinoc.match import Matches
from trinoc.report.calibration_part import MEANINGS, calibration_part
from trinoc.report.coverage_part import coverage_part
from trinoc.report.environment import environment
from trinoc.report.epipolar_part import corrected_circle_centres, ends_of_tracks, epipolar_part
from trinoc.report.features_part import feature_table, with_features
from trinoc.report.field_part import field_part
from trinoc.report.matches_part import matches_part
from trinoc.report.pictures import page_pictures
from trinoc.report.plan_part import plan_part
from trinoc.report.space_part import space_figure
from trinoc.report.verdict_part import verdict_part


class ExtraTable(NamedTuple):
    """A table that the caller adds to the page, such as a score against a known truth."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


def write_report(
    path: str | os.PathLike[str],
    *,
    result: CalibrationResult | None = None,
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
) -> None:
    """Write a self-contained HTML page about a calibration, a matching, or both.

    The page has only the parts that it is given something for, and makes no request to any
    network. The file is whole or not there; equal inputs give equal bytes.

    Parameters
    ----------
    result : a calibration, with `sheet_pictures`, (rows, columns[, channels]) per camera.
    rig : the cameras that `matches` was made with; by default that of `result`.
    segments, matches : found in `scene_pictures`, each optional.
    reference, reference_name : known cameras to stand beside the recovered ones.
    tables : further tables, shown after the matches.
    provenance : what to say at the foot: command, version, files.
    doubts : for cameras of `rig` whose calibration was suspect, why.
    features : found in `matches`, shown among them in space and as tables.

    Raises InputError where neither a rig nor a calibration nor segments are given, where the
    segments' or matches' views are not those of the rig, or where `path` cannot be written.
    """
    write_text(
        path,
        render_report(
            result=result,
            sheet_pictures=sheet_pictures,
            rig=rig,
            segments=segments,
            matches=matches,
            scene_pictures=scene_pictures,
            reference=reference,
            reference_name=reference_name,
            title=title,
            tables=tables,
            provenance=provenance,
            doubts=doubts,
            features=features,
        ),
    )


def render_report(
    *,
    result: CalibrationResult | None = None,
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
) -> str:
    """The page of `write_report` as text."""
    rig = rig if rig is not None else (result.rig if result is not None else None)
    if rig is None:
        raise InputError("A report needs a rig or a calibration: give at least one of them.")
    _check_views("segments", segments or {}, rig)
    _check_views("matches", matches.views if matches is not None else (), rig)
    sizes = {name: camera.image_size_px for name, camera in rig.items()}
    if result is not None:
        sizes |= {name: fit.detection.image_size_px for name, fit in result.fits.items()}
    sheet = page_pictures("sheet", sheet_pictures, sizes)
    scene = page_pictures("scene", scene_pictures, sizes)
    pattern = result.pattern if result is not None else None
    epipolar = []
    if result is not None:
        points = corrected_circle_centres(result)
        epipolar.append(epipolar_part("sheet", "circles", result.rig, points, sheet))
    if matches is not None:
        points = ends_of_tracks(matches)
        in_rig_order = points[:, [matches.views.index(name) for name in rig]]
        epipolar.append(epipolar_part("scene", "ends of tracks", rig, in_rig_order, scene))
    epipolar = [part for part in epipolar if part is not None]
    coverage = coverage_part(result, sheet) if result is not None else ()
    seen = sheet if result is not None else scene
    field = field_part(rig, pattern, matches, seen)
    space = space_figure(rig, pattern, matches)
    space = with_features(space, features)
    read = [own for own in features if own.READ_FIRST]
    tables = (
        *(ExtraTable(own.IN_WORDS.capitalize(), *feature_table(own)) for own in read),
        *tables,
    )
    page = {
        "title": title,
        "verdict": verdict_part(result, matches, doubts or {}, coverage, epipolar, field),
        "calibration": calibration_part(rig, result, sheet, reference, reference_name),
        "meanings": MEANINGS,
        "coverage": coverage,
        "field": field,
        "epipolar": epipolar,
        "matches": matches_part(_views(rig, matches), segments or {}, matches, scene)
        if segments or matches is not None
        else None,
        "pictures": [picture for picture in (*sheet.values(), *scene.values()) if picture.uri],
        "plans": plan_part(rig, pattern, matches),
        "space": space,
        "space_numbers": space.numbers(),
        "tables": tables,
        "provenance": dict(provenance or {}),
    }
    return environment().get_template("report.html.j2").render(page)


def _views(rig: Rig, matches: Matches | None) -> tuple[str, ...]:
    return rig.names if matches is None else matches.views


def _check_views(what: str, names: Mapping[str, Any] | Sequence[str], rig: Rig) -> None:
    unknown = [name for name in names if name not in rig.names]
    if unknown or (what == "matches" and names and set(names) != set(rig.names)):
        raise InputError(
            f"The views of the {what} are {', '.join(names)}, but the cameras of the rig are "
            f"{', '.join(rig.names)}: give the rig that the {what} belong to."
        )
