"""The tuned constants of `find_segments`, in one frozen value that can be swept.

    tuning = with_field(SegmentTuning(), "accept.soft_ratio", 2.0)     # trinoc.numerics
    segments = find_segments(image, tuning=tuning)

`tolerance_px`, `false_alarms` and `least_contrast` are arguments of `find_segments` itself. Values
come from the prototype, a numerical study that went before, or were chosen by hand on rendered
block scenes, unless a comment says more. All figures are of benchmarks/segments.py;
benchmarks/sweep.py prints what other values do. What is a property of the masks, of the polygon or
of linking, and numerical guards, stand where they are used.
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
    threshold: float = 3.0
    # Points may be this share as strong as an edge of the least contrast is on average. By hand.
    faint_share: float = 0.5
    # Least number of points of a run, at either level. By hand.
    least_fine: int = 6
    least_coarse: int = 5
    # Scale s, px, of the weight 1 / (1 + (r / s)^2)^2 of a point at a distance r from the line,
    # where the points fit well: a quarter at r = s, a hundredth at r = 3 s. By hand.
    robust_px: float = 0.3


@dataclass(frozen=True)
class AcceptTuning:
    """Sharp, straight edges of the scene. Shown by precision and "on rims of cylinders"."""

    # A profile whose variance is this much larger than usual is a soft shadow: on twelve rendered
    # scenes with shadows, the least at which no length is lost.
    soft_ratio: float = 1.4
    # In pictures whose edges have many widths, it is one beyond the usual width by so many times
    # the spread: from the lower quartile to the median of lines whose points are on average so many
    # times as strong as noise. On the corridor and the model house (VGG), and the same scenes:
    # neither 4 nor 6 lose precision, and 6 find what is found without a limit.
    soft_spreads: float = 6.0
    clear_ratio: float = 10.0
    # Slopes beside an edge are taken from so many widths of its profile to so many px farther out.
    # In a soft shadow the levels slope on both sides: by more than this share of the slope on the
    # line itself. By hand.
    beside_widths: float = 1.5
    beside_px: float = 3.0
    ramp_slope: float = 0.25
    # A line is no arc, all the same, where its bow explains less than this share of the points'
    # variance about it and is below this share of its length. By hand, on the same pictures.
    arc_explains: float = 0.7
    arc_bow_of_length: float = 0.04
    # Pieces of one arc, this near, px, turn from each to the next by an angle in this range,
    # degrees, and by what their bows promise within this factor. By hand; the least angle on the
    # same pictures, where 6 takes straight edges of photographs for arcs.
    next_px: float = 6.0
    turn_deg: tuple[float, float] = (10.0, 60.0)
    turn_ratio: float = 2.5
    # A piece shorter than this, px, is the rounding of a corner or of no use. By hand.
    least_length_px: float = 5.0


@dataclass(frozen=True)
class EndpointTuning:
    """Gaps and ends. Shown by the errors along the segment, at crossings and free."""

    # Collinear pieces merge across gaps up to this, and ends are carried to crossings up to that,
    # px. From the prototype.
    gap_px: float = 8.0
    snap_px: float = 6.0
    # Lines at less than this angle, degrees, may be pieces of one edge, and do not cross. By hand.
    parallel_deg: float = 15.0
    # Standard deviation of an end along its segment, px: at a crossing (by hand), and, on ten
    # rendered scenes, where the evidence of an edge of one grey level stops. It goes as one over
    # the root of the contrast, up to this limit. 7 and 12 px hold 92 % of the ends of other
    # scenes in three sigmas, not 79 %, but matching then finds half a hundredth less of the length.
    sigma_crossing_px: float = 0.5
    sigma_free_px: float = 32.0
    most_free_px: float = 7.0


@dataclass(frozen=True)
class ErrorTuning:
    """What widens a line's variance beyond noise: chosen so that errors of the segments it widens
    have about the variance that is claimed, on rendered block scenes without shadows, other ones
    than the benchmark's. Shown by the normalised error across and its share beyond 3 sigma."""

    # Noise also enters through the choice of points: its variance is this many times larger.
    # Measured on single edges.
    noise_excess: float = 1.2
    # What the model leaves out even on a perfect edge (sampling, kernel shape, rounding), px: a
    # part that is common to the whole edge, and a part per pixel of length that averages out.
    # Measured on single edges.
    model_sigma_px: float = 0.01
    model_sigma_per_pixel: float = 0.11
    # Lines are neighbours within so many widths of the profile. By hand.
    reach_widths: float = 3.0
    # Error, px, of a line all of whose points have a neighbour; of others as the share squared.
    crowd_px: float = 0.2
    # Of the variance from a neighbour all along a line, the share that turns it, too. On pictures
    # of brick walls (benchmarks/repetition.py), seeds 43 and 44: .25 to .45 do alike.
    turn_share: float = 0.33
    # How many sigmas of a bow, or of the distance of points from the line, noise explains.
    noise_sigmas: float = 2.0
    # Shares of a larger bow and scatter that stay an error; number of last points, and share of
    # their distance from the line that stays an error of that end.
    bow_share: float = 0.2
    scatter_share: float = 0.4
    last_points: int = 5
    off_share: float = 0.7
    # Share of the shift that slopes beside a line promise by which it is moved; of their size as
    # large a share stays as an error of the whole line; and the largest that both count, px. On
    # rendered scenes with soft shadows.
    shade_share: float = 0.3
    shade_most_px: float = 0.5
    # How far toward the brighter side a pixel must be saturated to bend the profile: so many
    # widths of the blur. On overexposed rendered scenes, where one width misses many.
    bright_side_widths: float = 1.75


@dataclass(frozen=True)
class SaturationTuning:
    """What is known before an edge with a saturated bright side is fitted. Shown by the rows of
    saturated edges: shift and normalised error."""

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
    # The profile is fitted from so many widths of the blur before the line, and a place farther off
    # is none, to where noise of so many sigmas would be clipped. By hand.
    fit_widths: float = 3.5
    white_sigmas: float = 2.5
    # The blur comes from edges with less than this share of their points beside others, and so
    # many times the noise in contrast. By hand.
    most_crowded: float = 0.2
    clear_contrast: float = 8.0


@dataclass(frozen=True)
class SegmentEndTuning:
    """Where segments meet and continue each other, and the levels beside them. By hand; shown by
    matching of rendered scenes."""

    # Ends are taken to meet within so many of their own sigmas, and this limit, px.
    sigmas: float = 3.0
    most_reach_px: float = 8.0
    # Two ends at a junction continue each other where they differ by less than this, degrees.
    straight_deg: float = 12.0
    # Pieces of one chain differ by less than this, degrees, across gaps of at most this, px.
    chain_deg: float = 4.0
    chain_gap_px: float = 30.0
    # Grey levels are taken this far from a segment, px: beyond the blur of its edge.
    beside_px: tuple[float, float, float] = (2.0, 3.0, 4.0)


@dataclass(frozen=True)
class SegmentTuning:
    """All groups; the default is what everything was measured with."""

    scales: ScaleTuning = field(default_factory=ScaleTuning)
    accept: AcceptTuning = field(default_factory=AcceptTuning)
    ends: EndpointTuning = field(default_factory=EndpointTuning)
    errors: ErrorTuning = field(default_factory=ErrorTuning)
    saturation: SaturationTuning = field(default_factory=SaturationTuning)
    junctions: SegmentEndTuning = field(default_factory=SegmentEndTuning)


DEFAULT = SegmentTuning()
