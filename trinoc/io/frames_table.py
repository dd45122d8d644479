"""The matches of many frames as one table.

Each frame has a name, a status, numbers of tracks and segments, and the scalar fields of `Matches`.
The tracks of all frames follow each other in the columns of `Matches`. A frame that failed has no
tracks, and its status is the reason.
"""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.errors import InputError
from trinoc.io.json_document import parsed_json
from trinoc.io.tables_npz import REMEDY, ArrayFields, build_table, list_arrays
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import (
    Column,
    ColumnCheck,
    Content,
    Table,
    list_fields,
)
from trinoc.recording.frame_table import OK, FrameMatches

# The columns of tracks, with the sides of a row.
OF_TRACKS = {
    field.name: field.sides[1:] for field in list_fields(Matches) if field.sides[:1] == ("t",)
}
_ARE_COUNTS = ColumnCheck(
    "is no number of them", lambda counts, _: (counts >= 0) & (counts < 2**31)
)


def _are_as_many(columns: Mapping[str, np.ndarray], table: Content) -> bool:
    return all(len(column) == table.values["tracks"].sum() for column in columns.values())


class Frames(Table):
    """Results of the frames of a recording, in one table.

    Attributes
    ----------
    views : tuple of str
        Names of the views, the order of axis v.
    frame : (f,)
        Name of each frame.
    status : (f,)
        Either "ok", or the reason why the frame has no matches.
    tracks : (f,)
        Number of tracks of each frame.
    segments : (f, v)
        Number of segments in each view.
    noise_scale, noise_tail : (f,)
        Noise parameters of the matches of each frame, as in `Matches`.
    counts, notes : (f,)
        Counts and notes of the matches of each frame, as JSON texts.
    reasons : (s,)
        Entry of `Matches.reasons` for each segment, frame by frame and view by view.
    columns : dict of arrays
        Columns of `Matches`, keyed by name, with one row for each track of all frames.
    """

    KIND: ClassVar[str] = "frames"
    SIDES: ClassVar[Mapping[str, str]] = {"f": "frames", "s": "segments", "v": "views"}

    views: Annotated[tuple[str, ...], Column(side="v")] = eqx.field(static=True)
    frame: Shaped[np.ndarray, "f"]
    status: Shaped[np.ndarray, "f"]
    tracks: Annotated[Int[np.ndarray, "f"], Column(_ARE_COUNTS)]
    segments: Annotated[Int[np.ndarray, "f v"], Column(_ARE_COUNTS)]
    noise_scale: Float[np.ndarray, "f"]
    counts: Shaped[np.ndarray, "f"]
    notes: Shaped[np.ndarray, "f"]
    reasons: Annotated[
        Shaped[np.ndarray, "s"],
        Column(
            ColumnCheck(
                "are not as many as there are segments",
                lambda reasons, table: len(reasons) == table.values["segments"].sum(),
            )
        ),
    ]
    columns: Annotated[
        dict[str, Shaped[np.ndarray, "_ ..."]],
        Column(
            ColumnCheck("have not as many rows as there are tracks", _are_as_many), per_row=True
        ),
    ]
    noise_tail: Float[np.ndarray, "f"] | None = None


def frames_of_results(results: Sequence[FrameMatches], views: Sequence[str]) -> Frames:
    """Convert the results of several frames to one table. `views` are the names of the views."""
    all_matches = [result.matches for result in results]
    successful = [matches for matches in all_matches if matches is not None]
    none = np.zeros(len(views), dtype=np.int64)
    arrays = [list_arrays(matches) for matches in successful] or [_no_tracks(len(views))]
    shared = set.intersection(*(set(each) for each in arrays))
    marks = {name for matches in successful for name in matches.marks} & shared
    return Frames(
        views=tuple(views),
        frame=np.array([result.name for result in results], dtype=np.str_),
        status=np.array([result.status for result in results], dtype=np.str_),
        tracks=np.array([0 if m is None else len(m) for m in all_matches], dtype=np.int64),
        segments=np.stack(
            [
                none if m is None else np.array([len(m.reasons[v]) for v in views])
                for m in all_matches
            ]
        ),
        noise_scale=np.array([1.0 if m is None else m.noise_scale for m in all_matches]),
        noise_tail=np.array([0.0 if m is None else m.noise_tail for m in all_matches]),
        counts=np.array([json.dumps({} if m is None else m.counts) for m in all_matches]),
        notes=np.array(
            [
                json.dumps([] if m is None else list(m.notes), ensure_ascii=False)
                for m in all_matches
            ]
        ),
        reasons=np.concatenate(
            [np.zeros(0, "<U1"), *(m.reasons[view] for m in successful for view in views)]
        ),
        columns={
            name: np.concatenate([each[name] for each in arrays])
            for name in (*OF_TRACKS, *sorted(marks))
            if name in shared
        },
    )


def _no_tracks(views: int) -> dict[str, np.ndarray]:
    """Columns of `Matches` without rows, keyed by name, for frames that have no matches.

    `views` is the number of views.
    """
    kinds = {"f": np.float64, "i": np.int64, "b": np.bool_, "U": "<U1"}
    dtypes = {field.name: kinds[field.kind] for field in list_fields(Matches) if field.kind}
    return {
        name: np.zeros((0, *sides_of_row(sides, views)), dtypes[name])
        for name, sides in OF_TRACKS.items()
    }


def sides_of_row(sides: Sequence[str], views: int) -> tuple[int, ...]:
    """Shape of a column of `Matches` without its first axis, the tracks.

    `sides` are the lengths of the other axes: numbers as text, or "v" for the number of views.
    """
    return tuple(views if side == "v" else int(side) for side in sides)


def results_of_frames(frames: Frames, file: str | os.PathLike[str]) -> list[FrameMatches]:
    """Convert a table to the results of its frames.

    Raise `InputError`, which names `file`, for values that no matching produces.
    """
    ends, of_segments = np.cumsum(frames.tracks), np.cumsum(frames.segments.sum(axis=1))
    results = []
    for k, (name, status) in enumerate(zip(frames.frame, frames.status, strict=True)):
        matches = None
        if status == OK:
            where = f'{file}, frame "{name}"'
            first = of_segments[k] - frames.segments[k].sum()
            reasons = np.split(
                frames.reasons[first : of_segments[k]], frames.segments[k].cumsum()[:-1]
            )
            rows = slice(ends[k] - frames.tracks[k], ends[k])
            counts, notes = (parsed_json(str(t[k]), file) for t in (frames.counts, frames.notes))
            arrays: dict[str, Any] = {
                field_name: column[rows] for field_name, column in frames.columns.items()
            }
            arrays |= {
                "views": frames.views,
                "noise_scale": frames.noise_scale[k],
                "notes": _texts(_sentences(notes, where)),
                "count_names": _texts(list(_counts(counts, where))),
                "count_values": np.array(list(counts.values()), dtype=np.int64),
                **{f"reasons/{view}": w for view, w in zip(frames.views, reasons, strict=True)},
            }
            if frames.noise_tail is not None:
                arrays["noise_tail"] = frames.noise_tail[k]
            field_arrays = {field_name: np.asarray(array) for field_name, array in arrays.items()}
            matches = build_table(Matches, ArrayFields(field_arrays, where))
        results.append(FrameMatches(str(name), str(status), matches))
    return results


def _counts(values: Any, where: str) -> dict[str, int]:
    good = isinstance(values, dict) and all(
        isinstance(v, int) and 0 <= v < 2**62 for v in values.values()
    )
    if not good:
        raise InputError(
            f'{where}: "counts" are no names with whole numbers: write the file again.'
        )
    return values


def _sentences(values: Any, where: str) -> list[str]:
    if not (isinstance(values, list) and all(isinstance(value, str) for value in values)):
        raise InputError(f'{where}: "notes" are no list of texts: {REMEDY}.')
    return values


def _texts(texts: Sequence[str]) -> np.ndarray:
    return np.array(texts, dtype=np.str_) if texts else np.zeros(0, "<U1")
