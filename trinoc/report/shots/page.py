"""One self-contained HTML page about a rig from many shots."""

import os
from collections.abc import Mapping

from trinoc.calib import RigFromShots
from trinoc.io import write_text
from trinoc.report.environment import environment
from trinoc.report.shots.boards import boards_in_space, plans_of_boards
from trinoc.report.shots.camera_field import caption_of_means, fields_of_cameras
from trinoc.report.shots.halves import halves_maps
from trinoc.report.shots.parameters import parameter_columns
from trinoc.report.shots.shot_table import shot_table
from trinoc.report.shots.uncertainty import uncertainty_maps
from trinoc.report.shots.verdict import verdict_of_shots


def write_shots_report(
    path: str | os.PathLike[str],
    result: RigFromShots,
    *,
    advice: str = "",
    title: str = "trinoc calibrate-rig",
    provenance: Mapping[str, str] | None = None,
) -> None:
    """Write what `calibrate_rig` found, and what speaks for and against it, as an HTML page.

    The page makes no request to any network. The file is whole or not there; equal inputs give
    equal bytes. A fit that failed has its shots and residuals shown, and no rig.

    Parameters
    ----------
    advice : a sentence on what to do next, such as that of `next_shot`.
    provenance : what to say at the foot: command, version, files.

    Raises InputError where `path` cannot be written.
    """
    page = render_shots_report(result, advice=advice, title=title, provenance=provenance)
    write_text(path, page)


def render_shots_report(
    result: RigFromShots,
    *,
    advice: str = "",
    title: str = "trinoc calibrate-rig",
    provenance: Mapping[str, str] | None = None,
) -> str:
    """The page of `write_shots_report` as text."""
    fields, maps, space = (
        fields_of_cameras(result),
        uncertainty_maps(result),
        boards_in_space(result),
    )
    page = {
        "title": title,
        "result": result,
        "advice": advice,
        "parameters": parameter_columns(result),
        "table": shot_table(result),
        "fields": fields,
        "captions": [caption_of_means(field) for field in fields],
        "halves": halves_maps(result),
        "uncertainty": maps,
        "space": space,
        "space_numbers": None if space is None else space.numbers(),
        "plans": plans_of_boards(result),
        "matches": None,
        "verdict": verdict_of_shots(result, fields, maps),
        "provenance": dict(provenance or {}),
    }
    return environment().get_template("shots.html.j2").render(page)
