"""Match files: every field of `Matches` as an npz."""

import os

import numpy as np

from trinoc.io.array_checks import LARGEST_MM, LARGEST_PX, ArrayFields, is_covariance
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.match import BINOCULAR, TRINOCULAR, Matches

FORMAT, VERSION = "trinoc-matches", 1
_REASONS = "reasons/"
# What files of earlier versions do not hold.
_FRAGMENTS_COVARIANCE, _MISFIT, _MOVES = "fragments_covariance_px2", "misfit", "viewpoint_dependent"
_GUIDED, _MEASURE = "guided", "measure"
_SILHOUETTE, _SHADOW = "silhouette", "shadow"


def save_matches(matches: Matches, path: str | os.PathLike[str]) -> None:
    """Write matches as npz, whole or not at all."""
    write_arrays(path, FORMAT, VERSION, arrays_of_matches(matches))


def arrays_of_matches(matches: Matches) -> dict[str, np.ndarray]:
    """The arrays of a file of matches, by name."""
    arrays = {
        "views": _texts(matches.views),
        "index": matches.index,
        "fragments_px": matches.fragments_px,
        "lines_mm": matches.lines_mm,
        "covariance_mm2": matches.covariance_mm2,
        "stage": _texts(matches.stage),
        "posterior": matches.posterior,
        "rival_posterior": matches.rival_posterior,
        "count_names": _texts(matches.counts),
        "noise_scale": np.array(matches.noise_scale, dtype=np.float64),
        "noise_tail": np.array(matches.noise_tail, dtype=np.float64),
        "notes": _texts(matches.notes),
        "count_values": np.array(list(matches.counts.values()), dtype=np.int64),
    }
    for name in (_FRAGMENTS_COVARIANCE, _MISFIT, _MOVES, _GUIDED, _SILHOUETTE, _SHADOW):
        if getattr(matches, name) is not None:
            arrays[name] = getattr(matches, name)
    if matches.measure is not None:
        arrays[_MEASURE] = _texts(matches.measure.ravel()).reshape(matches.measure.shape)
    reasons = {_REASONS + view: _texts(words) for view, words in matches.reasons.items()}
    return {**arrays, **reasons}


def load_matches(path: str | os.PathLike[str]) -> Matches:
    """Read matches that `save_matches` wrote.

    Raises InputError for another file, and, with the field and the first row, for what no matching
    can give: segments that do not exist, fragments where a view sees none, places that are not
    finite or beyond all scenes, covariances that are none, probabilities outside [0, 1].
    """
    return matches_of_fields(ArrayFields(read_arrays(path, FORMAT, VERSION), path))


def matches_of_fields(fields: ArrayFields) -> Matches:
    """The matches in the arrays of a file. Raises InputError as `load_matches` does."""
    views = tuple(map(str, fields.take("views", "U", (None,), "views")))
    if len(set(views)) < max(len(views), 2):
        raise fields.error(
            "views", f"are {', '.join(views) or 'none'}, but must be two or more different ones"
        )
    index = fields.take("index", "i", (None, len(views)), f"{len(views)} views")
    tracks, sides = index.shape
    what = f"{tracks} tracks in {sides} views"

    def take(name: str, *more: int, kind: str = "f") -> np.ndarray:
        return fields.take(name, kind, (tracks, *more), what)

    reasons = {
        name.removeprefix(_REASONS): fields.take(name, "U", (None,), "segments")
        for name in fields.arrays
        if name.startswith(_REASONS)
    }
    if set(reasons) != set(views):
        raise fields.error("reasons", "are not those of the views")
    existing = np.array([len(reasons[view]) for view in views])
    seen = index >= 0
    fields.expect("index", (index >= -1) & (index < existing), "names a segment that is not there")
    fields.expect("index", seen.sum(axis=1) >= 2, "names fewer than two segments")

    fragments = take("fragments_px", sides, 2, 2)
    fields.expect(
        "fragments_px",
        np.where(seen[..., None, None], np.abs(fragments) < LARGEST_PX, np.isnan(fragments)),
        "is no part of a segment where one is seen, or one where none is",
    )
    lines = take("lines_mm", 2, 3)
    fields.expect("lines_mm", np.abs(lines) < LARGEST_MM, "is not finite or beyond all scenes")
    covariance = take("covariance_mm2", 6, 6)
    fields.expect("covariance_mm2", is_covariance(covariance), "is no covariance")
    stage = take("stage", kind="U")
    words = np.where(seen.sum(axis=1) > 2, TRINOCULAR, BINOCULAR)
    fields.expect("stage", stage == words, f"is not {TRINOCULAR} or {BINOCULAR} as its views say")
    posterior, rival = take("posterior"), take("rival_posterior")
    for name, values in (("posterior", posterior), ("rival_posterior", rival)):
        fields.expect(name, (values >= 0) & (values <= 1 + 1e-9), "is no probability")

    fragments_covariance, misfit, moves = None, None, None
    if _FRAGMENTS_COVARIANCE in fields:
        fragments_covariance = take(_FRAGMENTS_COVARIANCE, sides, 4, 4)
        good = np.ones(index.shape, dtype=bool)
        good[seen] = is_covariance(fragments_covariance[seen])
        fields.expect(_FRAGMENTS_COVARIANCE, good, "is no covariance where a view sees the line")
    if _MISFIT in fields:
        misfit = take(_MISFIT)
        fields.expect(_MISFIT, ~(misfit < 0) & ~np.isinf(misfit), "is no chi-square")
    if _MOVES in fields:
        moves = take(_MOVES, kind="b")
    guided = None
    if _GUIDED in fields:
        guided = take(_GUIDED, sides, kind="b")
        fields.expect(_GUIDED, seen | ~guided, "is guided where no view sees the line")
    measure = None
    if _MEASURE in fields:
        measure = take(_MEASURE, sides, kind="U")
        fields.expect(_MEASURE, seen == (measure != ""), "is no word where a view sees the line")
    marks: dict[str, np.ndarray | None] = {_SILHOUETTE: None, _SHADOW: None}
    for name in marks:
        if name in fields:
            marks[name] = mark = take(name)
            fields.expect(name, (mark >= 0) & (mark <= 1 + 1e-9), "is no probability")
    noise_scale = 1.0
    if "noise_scale" in fields:
        noise_scale = float(fields.take("noise_scale", "f", (), "matches"))
        fields.expect("noise_scale", np.array([0 < noise_scale < np.inf]), "is no scale")
    noise_tail = 0.0
    if "noise_tail" in fields:
        noise_tail = float(fields.take("noise_tail", "f", (), "matches"))
        fields.expect("noise_tail", np.array([0 <= noise_tail < np.inf]), "is no tail")
    names = fields.take("count_names", "U", (None,), "counts")
    counts = fields.take("count_values", "i", names.shape, f"{len(names)} names")
    notes = fields.take("notes", "U", (None,), "notes") if "notes" in fields else ()
    return Matches(
        views=views,
        index=index,
        fragments_px=fragments,
        lines_mm=lines,
        covariance_mm2=covariance,
        stage=stage,
        posterior=posterior,
        rival_posterior=rival,
        reasons={view: reasons[view] for view in views},
        counts={str(name): int(count) for name, count in zip(names, counts, strict=True)},
        fragments_covariance_px2=fragments_covariance,
        misfit=misfit,
        viewpoint_dependent=moves,
        noise_scale=noise_scale,
        notes=tuple(map(str, notes)),
        guided=guided,
        measure=measure,
        silhouette=marks[_SILHOUETTE],
        noise_tail=noise_tail,
        shadow=marks[_SHADOW],
    )


def _texts(words: object) -> np.ndarray:
    """A fixed-width array of texts, which loads without pickle."""
    array = np.array(list(words), dtype=np.str_)  # pyright: ignore[reportArgumentType]
    return array if array.size else np.array([], dtype="<U1")
