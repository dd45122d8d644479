"""Match files: every field of `Matches` as an npz."""

import os

import numpy as np

from trinoc.errors import InputError
from trinoc.io.arrays_npz import read_arrays, take, write_arrays
from trinoc.match import BINOCULAR, TRINOCULAR, Matches

FORMAT, VERSION = "trinoc-matches", 1
_REASONS = "reasons/"
# What files of earlier versions do not hold.
_FRAGMENTS_COVARIANCE, _MISFIT, _MOVES = "fragments_covariance_px2", "misfit", "viewpoint_dependent"


def save_matches(matches: Matches, path: str | os.PathLike[str]) -> None:
    """Write matches as npz, whole or not at all."""
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
        "notes": _texts(matches.notes),
        "count_values": np.array(list(matches.counts.values()), dtype=np.int64),
    }
    for name in (_FRAGMENTS_COVARIANCE, _MISFIT, _MOVES):
        if getattr(matches, name) is not None:
            arrays[name] = getattr(matches, name)
    reasons = {_REASONS + view: _texts(words) for view, words in matches.reasons.items()}
    write_arrays(path, FORMAT, VERSION, {**arrays, **reasons})


def load_matches(path: str | os.PathLike[str]) -> Matches:
    """Read matches that `save_matches` wrote.

    Raises InputError for another file, arrays that do not fit together, and 3-D segments that
    are not finite.
    """
    arrays = read_arrays(path, FORMAT, VERSION)
    views = tuple(str(view) for view in take(arrays, "views", path))
    tracks, sides = len(take(arrays, "index", path)), len(views)
    shapes = {
        "index": (tracks, sides),
        "fragments_px": (tracks, sides, 2, 2),
        "lines_mm": (tracks, 2, 3),
        "covariance_mm2": (tracks, 6, 6),
        "stage": (tracks,),
        "posterior": (tracks,),
        "rival_posterior": (tracks,),
    }
    later = {_FRAGMENTS_COVARIANCE: (tracks, sides, 4, 4), _MISFIT: (tracks,), _MOVES: (tracks,)}
    shapes |= {name: shape for name, shape in later.items() if name in arrays}
    for name, shape in shapes.items():
        if take(arrays, name, path).shape != shape:
            raise InputError(
                f'{path}: "{name}" has shape {arrays[name].shape}, but {tracks} tracks in {sides} '
                f"views need {shape}: write the file again."
            )
    if not np.isfinite(arrays["lines_mm"]).all():
        track = int(np.flatnonzero(~np.isfinite(arrays["lines_mm"]).all(axis=(1, 2)))[0])
        raise InputError(
            f'{path}: "lines_mm" of track {track} is not finite: write the file again.'
        )
    if not np.isin(arrays["stage"], (TRINOCULAR, BINOCULAR)).all():
        raise InputError(
            f'{path}: "stage" holds words other than {TRINOCULAR} and {BINOCULAR}: '
            "write the file again."
        )
    return Matches(
        views=views,
        index=arrays["index"].astype(np.int64),
        fragments_px=arrays["fragments_px"].astype(np.float64),
        lines_mm=arrays["lines_mm"].astype(np.float64),
        covariance_mm2=arrays["covariance_mm2"].astype(np.float64),
        stage=arrays["stage"],
        posterior=arrays["posterior"].astype(np.float64),
        rival_posterior=arrays["rival_posterior"].astype(np.float64),
        reasons={
            name.removeprefix(_REASONS): words
            for name, words in arrays.items()
            if name.startswith(_REASONS)
        },
        counts={
            str(name): int(value)
            for name, value in zip(
                take(arrays, "count_names", path), take(arrays, "count_values", path), strict=True
            )
        },
        fragments_covariance_px2=arrays.get(_FRAGMENTS_COVARIANCE),
        misfit=arrays.get(_MISFIT),
        viewpoint_dependent=arrays[_MOVES].astype(bool) if _MOVES in arrays else None,
        noise_scale=float(arrays.get("noise_scale", 1.0)),
        notes=tuple(str(note) for note in arrays.get("notes", ())),
    )


def _texts(words: object) -> np.ndarray:
    """A fixed-width array of texts, which loads without pickle."""
    array = np.array(list(words), dtype=np.str_)  # pyright: ignore[reportArgumentType]
    return array if array.size else np.array([], dtype="<U1")
