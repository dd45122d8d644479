"""Tuned constants of `find_segments`, in one frozen value that can be swept.

    tuning = with_field(SegmentTuning(), "accept.soft_ratio", 2.0)     # trinoc.numerics
    segments = find_segments(image, tuning=tuning)

`tolerance_px`, `false_alarms` and `least_contrast` are arguments of `find_segments`. Unless a
comment says more, a value comes from the prototype, an earlier numerical study, or was set by hand
on rendered block scenes. All figures are from benchmarks/segments.py; benchmarks/sweep.py prints
the effect of other values. Properties of the masks, of the polygon and of linking, and numerical
guards, are in the files that use them.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class ScaleTuning:
    """Tuned constants of the search at full and at half resolution.

    Check them by recall and precision against noise (benchmarks/segments.py).
    """

    # Smallest mean ratio of strength to noise of a run at which the fine level is used alone. Below
    # it, edges break into fragments. By hand.
    clear_ratio: float = 6.0
    # Smallest strength of a point in units of the gradient noise, at both levels. From the
    # prototype; the false-alarm model is fitted to thresholds of 2.5 and above.
    threshold: float = 3.0
    # Smallest strength of a point, as a share of the mean strength of an edge of least contrast. By
    # hand.
    faint_share: float = 0.5
    # Smallest number of points of a run, at each level. By hand.
    least_fine: int = 6
    least_coarse: int = 5
    # Scale s, px, of the weight 1 / (1 + (r / s)^2)^2 of a point at distance r from a well-fitting
    # line: 1/4 at r = s, 1/100 at r = 3 s. By hand.
    robust_px: float = 0.3


@dataclass(frozen=True)
class AcceptTuning:
    """Tuned constants for the acceptance of lines as sharp, straight edges.

    Check them by precision and by "on rims of cylinders" (benchmarks/segments.py).
    """

    # Ratio of a profile's variance to the usual one above which an edge is a soft shadow. The
    # smallest without a loss of length on twelve rendered scenes with shadows.
    soft_ratio: float = 1.4
    # In images with many edge widths the limit grows by this many times their spread. The spread is
    # lower quartile to median, for lines with a mean strength of `clear_ratio` times the noise. On
    # the corridor and the model house (VGG) and the same scenes, 4 and 6 keep the precision, and 6
    # loses no segment.
    soft_spreads: float = 6.0
    clear_ratio: float = 10.0
    # Side slopes are measured from this many profile widths to this many px farther out. An edge is
    # a soft shadow if both side slopes exceed this share of the slope on the line. By hand.
    beside_widths: float = 1.5
    beside_px: float = 3.0
    ramp_slope: float = 0.25
    # A line is still straight if its bow explains less than this share of the points' variance and
    # is below this share of its length. By hand, on the same images.
    arc_explains: float = 0.7
    arc_bow_of_length: float = 0.04
    # Consecutive pieces of one arc: largest distance, px; range of the turn, degrees; largest
    # factor between the turn and the one predicted from the bows. By hand; on the same images, a
    # smallest angle of 6 takes straight edges of photographs for arcs.
    next_px: float = 6.0
    turn_deg: tuple[float, float] = (10.0, 60.0)
    turn_ratio: float = 2.5
    # Smallest length, px: shorter pieces are rounded corners or useless. By hand.
    least_length_px: float = 5.0


@dataclass(frozen=True)
class EndpointTuning:
    """Tuned constants of gaps between collinear lines, and of line ends.

    Check them by the errors along the segment, at crossings and at free ends
    (benchmarks/segments.py).
    """

    # Largest gap between merged collinear pieces, and largest distance of an end from the crossing
    # that it is moved to, px. From the prototype.
    gap_px: float = 8.0
    snap_px: float = 6.0
    # Lines at a smaller angle, degrees, may be pieces of one edge and do not cross. By hand.
    parallel_deg: float = 15.0
    # Standard deviation of an end along its segment, px: at a crossing (by hand); of a free end at
    # a contrast of one grey level (ten rendered scenes); its upper limit. It is proportional to
    # contrast^-1/2. Limits of 7 and 12 px contain 92 % of the ends of other scenes in three sigmas,
    # not 79 %, but matching then finds 0.5 % less of the length.
    sigma_crossing_px: float = 0.5
    sigma_free_px: float = 32.0
    most_free_px: float = 7.0


@dataclass(frozen=True)
class ErrorTuning:
    """Tuned constants for the variance of a line in addition to noise.

    Check them by the normalised error across, and by the share beyond 3 sigma
    (benchmarks/segments.py). They were chosen so that actual errors agree with the reported
    variance. The data were rendered block scenes without shadows, which the benchmark does not use.
    """

    # Factor of the noise variance, because noise also affects the choice of points. Measured on
    # single edges.
    noise_excess: float = 1.2
    # Model error on a perfect edge (sampling, kernel shape, rounding), px: one part common to the
    # whole edge, and one part per pixel of length, which averages out. Measured on single edges.
    model_sigma_px: float = 0.01
    model_sigma_per_pixel: float = 0.11
    # Largest distance of neighbours, in widths of the profile. By hand.
    reach_widths: float = 3.0
    # Error, px, of a line with neighbours at all points; proportional to the share squared.
    crowd_px: float = 0.2
    # Share of the variance from a neighbour along the whole line that also turns it. On images of
    # brick walls (benchmarks/repetition.py), seeds 43 and 44, .25 to .45 are equivalent.
    turn_share: float = 0.33
    # Bow and scatter below this many sigmas are attributed to noise.
    noise_sigmas: float = 2.0
    # Shares of larger bow and scatter that count as error. Number of last points, and share of
    # their mean distance from the line that counts as error of that end.
    bow_share: float = 0.2
    scatter_share: float = 0.4
    last_points: int = 5
    off_share: float = 0.7
    # Share of the shift predicted from side slopes that is corrected; the same share of the slopes'
    # size counts as an error of the whole line. Upper limit of both, px. On rendered scenes with
    # soft shadows.
    shade_share: float = 0.3
    shade_most_px: float = 0.5
    # Distance toward the brighter side at which saturation is tested, in widths of the blur. On
    # overexposed rendered scenes; one width misses many.
    bright_side_widths: float = 1.75


@dataclass(frozen=True)
class SaturationTuning:
    """Tuned constants and priors for edges with a saturated bright side.

    Check them by the shift and the normalised error of saturated edges (benchmarks/segments.py).
    """

    # Log of the true over the visible height of a step: mean and standard deviation. Saturated
    # surfaces exceed white by a third on average, rarely by a factor of three. By hand.
    log_above: float = 0.3
    log_above_sigma: float = 0.5
    # Relative standard deviation of the blur between edges.
    blur_spread: float = 0.03
    # With fewer unsaturated edges than this, the prior of the blur is this, px, with this relative
    # standard deviation.
    least_edges: int = 3
    unknown_blur_px: float = 0.8
    unknown_spread: float = 0.4
    # Deviation of a mean profile from a blurred step, as a share of its height, independent at each
    # quarter of a pixel. Share of the shift that counts as error, because blur is not Gaussian.
    misfit: float = 0.007
    shift_share: float = 0.07
    # The fit begins this many blur widths before the line, also the largest valid shift. It ends
    # where noise of this many sigmas would be clipped. By hand.
    fit_widths: float = 3.5
    white_sigmas: float = 2.5
    # The blur is measured on edges with at most this share of points near neighbours, and with at
    # least this ratio of contrast to noise. By hand.
    most_crowded: float = 0.2
    clear_contrast: float = 8.0


@dataclass(frozen=True)
class SegmentEndTuning:
    """Tuned constants of junctions, collinear chains and side levels, chosen by hand.

    Check them by the matching of rendered scenes.
    """

    # Largest distance at which ends meet, in sigmas of the end, and its upper limit, px.
    sigmas: float = 3.0
    most_reach_px: float = 8.0
    # Largest angle between two ends at a junction that continue each other, degrees.
    straight_deg: float = 12.0
    # Largest angle, degrees, and largest gap, px, between pieces of one chain.
    chain_deg: float = 4.0
    chain_gap_px: float = 30.0
    # Distances from a segment at which side levels are sampled, px: beyond the blur of its edge.
    beside_px: tuple[float, float, float] = (2.0, 3.0, 4.0)


@dataclass(frozen=True)
class SegmentTuning:
    """All tuned constants of `find_segments`, in groups.

    All reported figures were measured with the default values.
    """

    scales: ScaleTuning = field(default_factory=ScaleTuning)
    accept: AcceptTuning = field(default_factory=AcceptTuning)
    ends: EndpointTuning = field(default_factory=EndpointTuning)
    errors: ErrorTuning = field(default_factory=ErrorTuning)
    saturation: SaturationTuning = field(default_factory=SaturationTuning)
    junctions: SegmentEndTuning = field(default_factory=SegmentEndTuning)


DEFAULT = SegmentTuning()
