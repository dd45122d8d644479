"""The matches of many frames as a few long arrays: those of all frames one behind the other.

For each frame there are its name, its status, its number of tracks, its number of segments in each
view, and what `Matches` says of the whole; for each track and each segment what a file of one
frame's matches holds (`matches_npz.py`). A frame that failed has a status that says why, and no
tracks.
"""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trinoc.io.array_checks import ArrayFields
from trinoc.io.json_text import parsed_json
from trinoc.io.matches_npz import arrays_of_matches, matches_of_fields
from trinoc.match import Matches
from trinoc.recording import OK, FrameMatches

# (shape of a row, of how many views) of what each track has.
OF_TRACKS = {
    "index": ("v",),
    "fragments_px": ("v", 2, 2),
    "lines_mm": (2, 3),
    "covariance_mm2": (6, 6),
    "stage": (),
    "posterior": (),
    "rival_posterior": (),
    "fragments_covariance_px2": ("v", 4, 4),
    "misfit": (),
    "viewpoint_dependent": (),
}
_KINDS = {"index": "i", "stage": "U", "viewpoint_dependent": "b"}
OF_FRAMES = ("frame", "status", "tracks", "segments", "noise_scale", "counts", "notes")
# What each frame may have besides: files of earlier versions do not.
ALSO_OF_FRAMES = ("noise_tail",)


def arrays_of_frames(
    results: Sequence[FrameMatches], views: Sequence[str]
) -> dict[str, np.ndarray]:
    """All arrays of a file of frames."""
    found = [result.matches for result in results]
    good = [matches for matches in found if matches is not None]
    arrays = [arrays_of_matches(matches) for matches in good]
    none = np.zeros(len(views), dtype=np.int64)
    said = ({} if m is None else m.counts for m in found)
    noted = (() if m is None else m.notes for m in found)
    joined = {
        "views": _texts(views),
        "frame": _texts([result.name for result in results]),
        "status": _texts([result.status for result in results]),
        "tracks": np.array([0 if m is None else len(m) for m in found], dtype=np.int64),
        "segments": np.stack(
            [none if m is None else np.array([len(m.reasons[v]) for v in views]) for m in found]
        ),
        "noise_scale": np.array([1.0 if m is None else m.noise_scale for m in found]),
        "noise_tail": np.array([0.0 if m is None else m.noise_tail for m in found]),
        "counts": _texts([json.dumps(counts) for counts in said]),
        "notes": _texts([json.dumps(list(notes), ensure_ascii=False) for notes in noted]),
        "reasons": _texts([word for m in good for view in views for word in m.reasons[view]]),
    }
    for name, shape in OF_TRACKS.items():
        rows = [a[name] for a in arrays]
        empty = np.zeros((0, *_sides(shape, len(views))))
        joined[name] = np.concatenate(rows) if rows else empty.astype(_dtype(name))
    return joined


def frames_of_arrays(
    arrays: Mapping[str, np.ndarray], file: str | os.PathLike[str]
) -> list[FrameMatches]:
    """The frames in the arrays of a file. Raises InputError for what no matching can give."""
    fields = ArrayFields(arrays, file)
    views = fields.take("views", "U", (None,), "views")
    names = fields.take("frame", "U", (None,), "frames")
    what = f"{len(names)} frames"
    status = fields.take("status", "U", names.shape, what)
    tracks = fields.take("tracks", "i", names.shape, what)
    segments = fields.take("segments", "i", (len(names), len(views)), what)
    noise_scale = fields.take("noise_scale", "f", names.shape, what)
    also = {
        name: fields.take(name, "f", names.shape, what) for name in ALSO_OF_FRAMES if name in fields
    }
    counts = fields.take("counts", "U", names.shape, what)
    notes = fields.take("notes", "U", names.shape, what)
    rows = {
        name: fields.take(
            name, _kind(name), (None, *_sides(shape, len(views))), f"{len(views)} views"
        )
        for name, shape in OF_TRACKS.items()
    }
    reasons = fields.take("reasons", "U", (None,), "segments")
    for name, numbers in (("tracks", tracks), ("segments", segments)):
        fields.expect(name, (numbers >= 0) & (numbers < 2**31), "is no number of them")
    for name, values in rows.items():
        if len(values) != tracks.sum():
            raise fields.error(name, f"has {len(values)} rows for {tracks.sum()} tracks")
    if len(reasons) != segments.sum():
        raise fields.error("reasons", f"are {len(reasons)} for {segments.sum()} segments")

    found, track, segment = [], 0, 0
    for k, (name, said) in enumerate(zip(names, status, strict=True)):
        words = np.split(reasons[segment : segment + segments[k].sum()], segments[k].cumsum()[:-1])
        own = {column: values[track : track + tracks[k]] for column, values in rows.items()}
        track, segment = track + tracks[k], segment + segments[k].sum()
        matches = None
        if said == OK:
            of_counts, of_notes = (parsed_json(str(t[k]), file) for t in (counts, notes))
            numbers = _counts(of_counts, fields)
            own |= {
                "views": views,
                "noise_scale": noise_scale[k],
                **{column: values[k] for column, values in also.items()},
                "count_names": _texts(numbers),
                "count_values": np.array(list(numbers.values()), dtype=np.int64),
                "notes": _texts(_sentences(of_notes, fields)),
                **{f"reasons/{view}": w for view, w in zip(views, words, strict=True)},
            }
            matches = _matches(own, name, file)
        found.append(FrameMatches(str(name), str(said), matches))
    return found


def _matches(arrays: Mapping[str, Any], frame: str, file: str | os.PathLike[str]) -> Matches:
    whole = {name: np.asarray(array) for name, array in arrays.items()}
    return matches_of_fields(ArrayFields(whole, f'{file}, frame "{frame}"'))


def _counts(values: Any, fields: ArrayFields) -> dict[str, int]:
    good = isinstance(values, dict) and all(
        isinstance(v, int) and 0 <= v < 2**62 for v in values.values()
    )
    if not good:
        raise fields.error("counts", "are no names with whole numbers")
    return values


def _sentences(values: Any, fields: ArrayFields) -> list[str]:
    if not (isinstance(values, list) and all(isinstance(value, str) for value in values)):
        raise fields.error("notes", "are no list of texts")
    return values


def _sides(shape: tuple[int | str, ...], views: int) -> tuple[int, ...]:
    return tuple(views if side == "v" else int(side) for side in shape)


def _dtype(name: str) -> np.dtype:
    return np.dtype({"i": np.int64, "U": "<U1", "b": np.bool_, "f": np.float64}[_kind(name)])


def _kind(name: str) -> str:
    return _KINDS.get(name, "f")


def _texts(words: Any) -> np.ndarray:
    array = np.array(list(words), dtype=np.str_)
    return array if array.size else np.array([], dtype="<U1")
