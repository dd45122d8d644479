"""The tuned constants of `find_segments`, in one frozen value that can be swept.

    tuning = with_field(SegmentTuning(), "accept.soft_ratio", 2.0)     # trinoc.numerics
    segments = find_segments(image, tuning=tuning)

`tolerance_px`, `false_alarms` and `least_contrast` are arguments of `find_segments` itself. Values
come from the prototype, a numerical study that went before, or were chosen by hand on rendered
block scenes, unless a comment says more. All figures are of benchmarks/segments.py. What is a
property of the masks, of the polygon or of linking, and numerical guards, stand where they are
used.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class ScaleTuning:
    """Full and half resolution. Shown by recall and precision, by noise."""

    # Below this mean ratio of strength to noise the fine level links an edge only in fragments.
    # By hand.
    clear_ratio: float = 6.0
    # Least strength of a point, over the noise of the gradient, at either level. From the
    # prototype; `nfa` is fitted to thresholds of 2.5 and above.
    fine_threshold: float = 3.0
    coarse_threshold: float = 3.0
    # Points may be this share as strong as an edge of the least contrast is on average. By hand.
    faint_share: float = 0.5
    # Least number of points of a run, at either level. By hand.
    least_fine: int = 6
    least_coarse: int = 5


@dataclass(frozen=True)
class AcceptTuning:
    """Sharp, straight edges of the scene. Shown by precision and "on rims of cylinders"."""

    # A profile whose variance is this much larger than usual is a soft shadow (prototype),
    soft_ratio: float = 1.5
    # and in pictures whose edges have many widths one beyond so many half ranges between their
    # quartiles, at most so much larger. By hand, on three photographs and ten rendered scenes,
    soft_spreads: float = 4.0
    soft_most: float = 3.0
    # unless its blur has less than this variance, px^2: photographs with depth have edges of
    # many widths. By hand; shown by Merton.
    sharp_px2: float = 2.0
    # A bow of more than this, px, is an arc whatever its neighbours do, if its radius is below
    # this share of the picture's width. The share is from the prototype, the bow by hand.
    arc_bow_px: float = 0.8
    arc_radius_of_width: float = 0.2
    # A line is no arc, all the same, where its bow explains less than this share of the points'
    # variance about it, is below this share of its length, and the line is longer than this, px. By
    # hand, on the same pictures.
    arc_explains: float = 0.7
    arc_bow_of_length: float = 0.04
    arc_least_px: float = 12.0
    # Pieces of one arc, bowed by at least this, px, and this near, px, turn from each to the next
    # by an angle in this range, degrees, and by what their bows promise within this factor. By
    # hand.
    least_bow_px: float = 0.2
    next_px: float = 6.0
    turn_deg: tuple[float, float] = (6.0, 60.0)
    turn_ratio: float = 2.5
    # Contrast is judged once neighbours are taken out, which rarely adds more than this share
    # leaves. By hand.
    faint_share: float = 0.8
    # A piece shorter than this, px, with this share of its points within reach of other edges is
    # the rounding of a corner. By hand.
    bevel_px: float = 5.0
    bevel_crowded: float = 0.8


@dataclass(frozen=True)
class EndpointTuning:
    """Gaps and ends. Shown by the errors along the segment, at crossings and free."""

    # Collinear pieces merge across gaps up to this, and ends are carried to crossings up to that,
    # px. From the prototype.
    gap_px: float = 8.0
    snap_px: float = 6.0
    # Standard deviation of an end along its segment, px: at a crossing (by hand), and, on ten
    # rendered scenes, where the evidence of an edge of this contrast stops. It goes as one over the
    # root of the contrast, between these limits. 7 and 12 px hold 92 % of the ends of other scenes
    # in three sigmas instead of 79 %, but matching then finds half a hundredth less of the length.
    sigma_crossing_px: float = 0.5
    sigma_free_px: float = 4.5
    free_contrast: float = 50.0
    least_free_px: float = 2.0
    most_free_px: float = 7.0


@dataclass(frozen=True)
class ErrorTuning:
    """What widens a line's variance beyond noise: chosen so that errors of the segments it widens
    have about the variance that is claimed, on rendered block scenes without shadows, other ones
    than the benchmark's. Shown by the normalised error across and its share beyond 3 sigma."""

    # Share of the shift ascribed to neighbours that stays as an error.
    pull_share: float = 0.8
    # Error, px, per share of points with a neighbour beyond the first share.
    crowd_px: float = 0.4
    crowd_from: float = 0.4
    # Share of the widening of the profile, px, beyond a first part, px.
    wide_share: float = 0.2
    wide_from_px: float = 0.5
    # Share of the bow that noise does not explain, and how many sigmas noise explains.
    bow_share: float = 0.2
    bow_sigmas: float = 1.5
    # Share of the points' scatter that noise does not explain, and how many times its variance
    # noise explains; share of the distance of the last points from the line, that stays an error of
    # that end, and from how many sigmas of it.
    scatter_share: float = 0.4
    scatter_noise: float = 2.0
    off_share: float = 0.7
    off_sigmas: float = 3.0
    # Share of the shift that slopes beside a line promise by which it is moved, share of their size
    # that stays as an error of the whole line, and the largest that both count, px. On twelve
    # rendered scenes with soft shadows.
    shade_shift: float = 0.3
    shade_share: float = 0.5
    shade_most_px: float = 0.5
    # How far toward the brighter side a pixel must be saturated to bend the profile: at least so
    # many pixels of the level, and so many widths of the blur.
    bright_side_px: float = 2.0
    bright_side_widths: float = 1.75
    # A line borrows the picture's usual blur where its own differs by more than this share.
    blur_spread: float = 0.15


@dataclass(frozen=True)
class SaturationTuning:
    """What is known before an edge with a saturated bright side is fitted. Shown by the rows of
    saturated edges: shift and normalised error."""

    # Share of saturated points from which a line is fitted as saturated. By hand.
    from_share: float = 0.3
    # Logarithm of the true height of a step over the visible one, and its deviation: surfaces
    # above white are so by a third or so, rarely by three times. By hand.
    log_above: float = 0.3
    log_above_sigma: float = 0.5
    # The blur of one edge differs from that of others by this share.
    blur_spread: float = 0.03
    # With fewer unsaturated edges than this, the blur is taken to be this, px, within this factor.
    least_edges: int = 3
    unknown_blur_px: float = 0.8
    unknown_spread: float = 0.4
    # A mean profile differs from a blurred step by this share of its height, independently at each
    # quarter of a pixel; and of the shift this share stays as an error, as blurs are not Gaussian.
    misfit: float = 0.007
    shift_share: float = 0.07
    # The height above white changes along an edge: share of the shift by which its ends differ.
    uneven_share: float = 0.05
    # Error, in widths of the blur, where too little of the profile is seen for a fit.
    unfitted_widths: float = 0.6


@dataclass(frozen=True)
class SegmentTuning:
    """All groups; the default is what everything was measured with."""

    scales: ScaleTuning = field(default_factory=ScaleTuning)
    accept: AcceptTuning = field(default_factory=AcceptTuning)
    ends: EndpointTuning = field(default_factory=EndpointTuning)
    errors: ErrorTuning = field(default_factory=ErrorTuning)
    saturation: SaturationTuning = field(default_factory=SaturationTuning)


DEFAULT = SegmentTuning()
