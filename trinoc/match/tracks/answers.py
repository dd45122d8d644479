"""What a user should know of the matches as a whole, in sentences."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.geometry.intrinsics import distort_pixels
from trinoc.match.evidence.mixture import probability
from trinoc.match.observations.match_input import BEYOND_FOLD, FrameInput, MatchInput
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.unequal_errors import (
    degrees_of_misfit,
    fit_tails,
    scale_covariance_of_lines,
    variance_factor,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.match.tuning.tracks import TrackTuning


def in_line(centre_mm: Float[np.ndarray, "f v 3"]) -> Bool[np.ndarray, "f"]:
    """Whether the cameras' centres lie on one line, of each frame."""
    centred = centre_mm - centre_mm.mean(axis=1, keepdims=True)
    spread = np.linalg.svd(centred, compute_uv=False)
    return spread[:, 1] < DEFAULT.tracks.in_line_share * spread[:, 0]


def narrow_notes(frame: FrameInput) -> tuple[str, ...]:
    """A sentence where cameras stand nearly at one place, for what their pictures show."""
    tuning, names = DEFAULT.tracks, frame.names
    centres = frame.cameras.centre_mm
    apart_mm = np.linalg.norm(centres[:, None] - centres, axis=2)
    # Among three cameras or more, others are farther apart.
    limit_mm = np.inf if len(names) == 2 else tuning.narrow_baselines * apart_mm.max()
    narrow = [
        (first, second, share)
        for first, second in combinations(range(len(names)), 2)
        if apart_mm[first, second] < limit_mm
        and (share := _share_at_infinity(frame, first, second)) > tuning.narrow_share
    ]
    if not narrow:
        return ()
    first, second, share = narrow[0]
    more = f", and {len(narrow) - 1} more pairs of cameras as well" if len(narrow) > 1 else ""
    pair = " and ".join(f'"{name}"' for name in sorted((names[first], names[second])))
    baseline_mm = apart_mm[first, second]
    return (
        f"The cameras {pair} stand nearly at one place, {baseline_mm:.2g} mm apart{more}: "
        f"{100 * share:.0f} % of the segments lie in both pictures as if they were infinitely far, "
        "so that the two give no depth; move one of the cameras, or check the rig.",
    )


def _fold_notes(frame: FrameInput) -> tuple[str, ...]:
    """A sentence where segments are left out because they lie beyond the fold of a lens."""
    counts = {
        name: int((left_out == BEYOND_FOLD).sum())
        for name, left_out in zip(frame.names, frame.left_out, strict=True)
    }
    counts = {name: counts[name] for name in sorted(counts) if counts[name]}
    if not counts:
        return ()
    radius_px = {
        name: lens.valid_radius_px
        for name, lens in zip(frame.names, frame.cameras.intrinsics, strict=True)
    }
    beyond = ", ".join(
        f'{count} of "{name}" (beyond {radius_px[name]:.0f} px)' for name, count in counts.items()
    )
    return (
        "Segments farther from the principal point than a lens maps one to one are left out: "
        f"{beyond}; calibrate with the board nearer to the corners to use them.",
    )


def _share_at_infinity(frame: FrameInput, first: int, second: int) -> float:
    """Of the longest segments of one view: the share that lies, as if it were infinitely far, on a
    segment of another view."""
    tuning = DEFAULT.tracks
    ends, others = frame.ends_px[first], frame.ends_px[second]
    if min(len(ends), len(others)) < tuning.narrow_segments[0]:
        return 0.0
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends = ends[np.argsort(-length, kind="stable")[: tuning.narrow_segments[1]]]
    matrices = frame.cameras.matrix_px[:, :, :3]
    at_infinity = matrices[second] @ np.linalg.inv(matrices[first])
    moved = np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=2) @ at_infinity.T
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.where(moved[..., 2:] > 0, moved[..., :2] / moved[..., 2:], np.inf)
    step = others[:, 1] - others[:, 0]
    other_length = np.linalg.norm(step, axis=1)
    direction = step / other_length[:, None]
    with np.errstate(invalid="ignore"):
        offset = moved[:, :, None] - others[:, 0]
        across = np.abs(offset[..., 0] * direction[:, 1] - offset[..., 1] * direction[:, 0])
        along = np.sum(offset.mean(axis=1) * direction, axis=2)
    variances = [
        np.median(np.linalg.eigvalsh(frame.covariance_px2[view][:, :2, :2])[:, 0])
        for view in (first, second)
    ]
    limit_px = tuning.narrow_sigmas * np.sqrt(sum(variances))
    is_on = (across.max(axis=1) < limit_px) & (along > 0) & (along < other_length)
    return float(is_on.any(axis=1).mean())


def write_notes(
    views: int,
    cameras_in_line: bool,
    unlocated: int,
    noise_scale: float,
    let_go: int,
    tuning: NoiseTuning = DEFAULT.noise,
) -> tuple[str, ...]:
    """Sentences on noise that is not as stated, on more rivals than memory bears, and on cameras in
    one line."""
    notes = []
    if let_go:
        notes.append(
            f"The pictures repeat themselves: {let_go} likely triples were let go, as memory bears "
            "no more, and the probabilities of their rivals are lowered by their share; leave out "
            "the shortest segments, or match parts of the pictures."
        )
    if not 1 / tuning.noted <= noise_scale <= tuning.noted:
        word = "larger" if noise_scale > 1 else "smaller"
        notes.append(
            f"The segments' errors are {word} than stated, {noise_scale:.2g} times: covariances "
            "are of the errors found; give a sigma_px that is as much "
            f"{word} to have candidates judged by it too."
        )
    if views > 2:
        if cameras_in_line:
            notes.append(
                "The cameras' centres lie on one line: segments along it are along the epipolar "
                f"lines of all views, and no pair of views locates them ({unlocated} tracks left "
                "out); move one camera off the line to see them."
            )
    elif unlocated:
        notes.append(
            f"Two views do not locate segments along their epipolar lines ({unlocated} tracks "
            "left out): a third view off the line of the two would."
        )
    return tuple(notes)


MATCHED = "matched"
OF_PATTERN = f"{MATCHED} within a pattern"
NO_PARTNER = "no partner in the zone"
OUTSIDE = "outside depth"
ALONG = "along the epipolar lines"
WEAK = "evidence too weak"
MISSED = "missing in a third view"
LOST = "lost to a neighbour"
AMBIGUOUS = "ambiguous with {}"


def reasons(
    segment: Int[np.ndarray, "m"],
    log_odds: Float[np.ndarray, "m"],
    outside: Bool[np.ndarray, "n"],
    along: Bool[np.ndarray, "n"],
    matched: Bool[np.ndarray, "n"],
    missed: Bool[np.ndarray, "n"],
    of_pattern: Bool[np.ndarray, "n"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> Shaped[np.ndarray, "n"]:
    """(n,) words for the segments of one view, given the candidates that held each of them.

    `segment` is the segment of this view in each candidate (-1 for none), `log_odds` the
    candidate's evidence before rivals, `outside` whether the depth range excluded one,
    `along` whether the best lies along the epipolar lines of all pairs of its views, and
    `missed` whether one fits in two views, and a third should show it but does not: the rims of
    round bodies, and shadows and lights that move with the viewpoint, among others. `of_pattern`
    are matched, and a pattern that repeats is what leaves the match in doubt.
    """
    count = len(matched)
    held = segment >= 0
    segment, log_odds = segment[held], log_odds[held]
    best = np.full(count, -np.inf)
    np.maximum.at(best, segment, log_odds)
    serious = (log_odds > best[segment] - tuning.rival_log_odds) & (log_odds > 0)
    rivals = np.bincount(segment[serious], minlength=count)
    words = np.full(count, NO_PARTNER, dtype="U40")
    words[outside] = OUTSIDE
    words[np.isfinite(best)] = WEAK
    words[missed & np.isfinite(best)] = MISSED
    words[best > 0] = LOST
    for n in np.flatnonzero((best > 0) & (rivals > 1)):
        words[n] = AMBIGUOUS.format(rivals[n])
    words[along] = ALONG
    words[matched] = MATCHED
    words[of_pattern] = OF_PATTERN
    return words


def count_reasons(words: dict[str, Shaped[np.ndarray, "_"]]) -> dict[str, int]:
    """How many segments of all views share each reason; ambiguous ones are one kind."""
    number: Counter[str] = Counter()
    # Few words are different: those are taken apart, not every segment's.
    for word, count in Counter(word for view in words.values() for word in view.tolist()).items():
        number[word.split(" with ")[0]] += count
    return {f"segments {kind}": number[kind] for kind in sorted(number)}


# The count of tracks that no pair of views can locate, of which notes speak.
UNLOCATED = "tracks along the epipolar lines"
# The count of likely triples beyond what memory bears.
LET_GO = "triples let go for memory"
# Counts of tracks in three views that are sure, and next to certain, against chance: as if no
# pattern repeated.
SURE, CERTAIN = "tracks sure against chance", "tracks certain against chance"


class Lines(NamedTuple):
    """Tracks of all frames, by the matcher's own numbers of segments and order of views.

    chance_log_odds : as `posterior_log_odds`, without what patterns take from it.
    member_posterior : as in `Tracks`.
    """

    index: Int[np.ndarray, "t v"]
    fragments_px: Float[np.ndarray, "t v 2 2"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    fragments_covariance_px2: Float[np.ndarray, "t v 4 4"]
    misfit: Float[np.ndarray, "t"]
    viewpoint_dependent: Bool[np.ndarray, "t"]
    of_pattern: Bool[np.ndarray, "t"]
    chance_log_odds: Float[np.ndarray, "t"]
    member_posterior: Float[np.ndarray, "t v"]

    def index_likelier_than(self, posterior: float) -> Int[np.ndarray, "_ v"]:
        """Segments of the tracks in three views or more that are so likely against chance."""
        in_three = (self.index >= 0).sum(axis=1) > 2
        return self.index[in_three & (probability(self.chance_log_odds) > posterior)]


def answers(
    seen: MatchInput,
    found: Lines,
    frame: Int[np.ndarray, "t"],
    words: list[Shaped[np.ndarray, "_"]],
    counts: Mapping[str, Int[np.ndarray, "_f"]],
    names: Sequence[tuple[str, ...]],
    noise_scale: Float[np.ndarray, "f"],
    tuning: NoiseTuning,
) -> list[Matches]:
    """Matches of each frame, whose views are the caller's `names`.

    `frame` is that of each track, `words` say of every segment of a view why it is on no track,
    and `counts` are of each frame.
    """
    found, tail = _with_unequal_errors(found, frame, seen.frames, tuning)
    given, fragments = _as_given(seen, found, frame)
    pairs = zip(seen.frames, names, strict=True)
    turn = np.array([[own.names.index(name) for name in called] for own, called in pairs])
    rows = np.arange(len(frame))[:, None], turn[frame]
    given, fragments, covariance, members = (
        column[rows]
        for column in (given, fragments, found.fragments_covariance_px2, found.member_posterior)
    )
    posterior = probability(found.posterior_log_odds)
    members = np.where(np.isnan(members) & (given >= 0), posterior[:, None], members)
    places = fragments[:, :, 0].reshape(len(frame), 2 * turn.shape[1])
    keys = *given.T[::-1], frame
    order = np.lexsort(keys)
    # Parts of the same segments follow their places.
    if np.all([np.diff(key[order]) == 0 for key in keys], axis=0).any():
        order = np.lexsort((*places.T, *keys))
    columns = {
        "index": given,
        "fragments_px": fragments,
        "lines_mm": found.ends_mm,
        "covariance_mm2": found.covariance_mm2,
        "stage": np.where((given >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        "posterior": posterior,
        "member_posterior": members,
        "rival_posterior": probability(found.rival_posterior),
        "fragments_covariance_px2": covariance,
        "misfit": found.misfit,
        "viewpoint_dependent": found.viewpoint_dependent,
    }
    bounds = np.searchsorted(frame[order], np.arange(len(names) + 1))
    words_of_frames = _words_as_given(seen, words)
    aligned = in_line(np.stack([own.cameras.centre_mm for own in seen.frames]))
    results = []
    for number, called in enumerate(names):
        own = order[slice(*bounds[number : number + 2])]
        mine: dict[str, Any] = {name: column[own] for name, column in columns.items()}
        why = {
            name: words_of_frames[number][view]
            for name, view in zip(called, turn[number].tolist(), strict=True)
        }
        scale = float(noise_scale[number])
        numbers = {name: int(of_frames[number]) for name, of_frames in counts.items()}
        results.append(
            Matches(
                **mine,
                views=called,
                reasons=why,
                counts=numbers | count_reasons(why),
                noise_scale=scale,
                notes=(
                    *write_notes(
                        len(called),
                        bool(aligned[number]),
                        numbers[UNLOCATED],
                        scale,
                        numbers[LET_GO],
                        tuning,
                    ),
                    *narrow_notes(seen.frames[number]),
                    *_fold_notes(seen.frames[number]),
                ),
                noise_tail=float(tail[number]),
            )
        )
    return results


def _with_unequal_errors(
    found: Lines, frame: Int[np.ndarray, "t"], frames: Sequence[FrameInput], tuning: NoiseTuning
) -> tuple[Lines, Float[np.ndarray, "f"]]:
    """(lines whose covariances allow for errors that differ from track to track, the tail of these
    in each frame)."""
    degrees = degrees_of_misfit(found.index)
    sure = (degrees > 0) & (probability(found.posterior_log_odds) > tuning.sure)
    of_pictures = np.array([any(np.isfinite(view).any() for view in own.sides) for own in frames])
    tail = fit_tails(found.misfit[sure], degrees[sure], frame[sure], of_pictures, tuning)
    factor = variance_factor(found.misfit, degrees, tail[frame])
    covariance = scale_covariance_of_lines(found.ends_mm, found.covariance_mm2, factor)
    return found._replace(covariance_mm2=covariance), tail


def _as_given(
    seen: MatchInput, found: Lines, frame: Int[np.ndarray, "t"]
) -> tuple[Int[np.ndarray, "t v"], Float[np.ndarray, "t v 2 2"]]:
    """(the caller's numbers of segments, parts of these in pixels of the picture)."""
    given, fragments = np.full(found.index.shape, -1), found.fragments_px.copy()
    for view in range(found.index.shape[1]):
        on = np.flatnonzero(found.index[:, view] >= 0)
        order = np.concatenate([own.order[view] for own in seen.frames])
        given[on, view] = order[found.index[on, view]]
        lenses = [own.cameras.intrinsics[view] for own in seen.frames]
        # Frames of one rig share their lenses.
        for lens in {id(lens): lens for lens in lenses if lens.has_distortion}.values():
            rows = on[np.array([own is lens for own in lenses])[frame[on]]]
            fragments[rows, view] = distort_pixels(lens, fragments[rows, view])
    return given, fragments


def _words_as_given(
    seen: MatchInput, words: list[Shaped[np.ndarray, "_"]]
) -> list[list[Shaped[np.ndarray, "_"]]]:
    """Words of each frame and view, in the caller's order; why those were left out that were."""
    starts, given = seen.starts, []
    for number, frame in enumerate(seen.frames):
        given.append([column.astype("U40") for column in frame.left_out])
        for view, order in enumerate(frame.order):
            own = words[view][slice(*starts[number : number + 2, view])]
            given[-1][view][order] = own
    return given
