"""All groups of tuned constants of calibration as one value."""

from dataclasses import dataclass, field

from trinoc.calib.tuning.detection import DetectionTuning
from trinoc.calib.tuning.photometric import PhotometricTuning


@dataclass(frozen=True)
class TargetTuning:
    """Tuned constants for the sizes of a proposed sheet, and limits of plausible sizes.

    Chosen by hand.
    """

    # Side of a proposed sheet as a share of the shorter side of the field of view. The rest is a
    # margin for aiming and for oblique views.
    field_share: float = 0.6
    # Desired and smallest diameter of a circle's image, px.
    good_px: float = 20.0
    least_px: float = 10.0
    # Radius of a circle as a share of the pitch, and the step to which the pitch is rounded, mm.
    radius_share: float = 0.3
    step_mm: float = 0.5
    # Largest relative error of a printed length. Printers are wrong by a percent; a larger error
    # is a mistake in measuring or a wrong unit.
    largest_change: float = 0.3
    # Largest distance of a measured circle centre from a regular lattice, in pitches.
    off_lattice: float = 0.25


@dataclass(frozen=True)
class UncertaintyTuning:
    """Default standard deviations of sheet, aim and lens, used by `Systematics.typical`.

    The aim is the point at which the optical axis of a camera meets the sheet. Chosen by hand.
    Check with the coverage in benchmarks/calibration_conditions.py.
    """

    # Relative standard deviation of the scale of the print.
    print_size: float = 2e-3
    # The same of each side beside the common scale. A difference of 1 % between X and Y is then
    # within four sigmas. One image hardly shows it, and with 7e-4 the pan was wrong by 10 sigma
    # without a warning.
    print_stretch: float = 2e-3
    # Standard deviations of the height of the sheet at its edge, and of the point at which a camera
    # is aimed, mm.
    flatness_mm: float = 0.3
    aim_mm: float = 20.0
    # Standard deviations of a data sheet's lens: relative focal length, its aspect ratio, principal
    # point over the image width, and distortion at the corner of the image, px.
    focal_length: float = 1e-2
    aspect: float = 2e-3
    principal_point: float = 2e-2
    distortion_px: float = 1.0


@dataclass(frozen=True)
class ProblemTuning:
    """Tuned limits that separate noise from errors of points, images, cameras and boards.

    Check with errors and coverage of benchmarks/rigs.py and benchmarks/calibration.py.
    """

    # Largest residual of a point, in robust standard deviations. Noise exceeds it once in 10^8; the
    # point was located wrongly. By hand.
    gate: float = 6.0
    # Scales of the robust loss from round to round, in robust standard deviations. By hand.
    annealing: tuple[float, ...] = (30.0, 10.0, 5.0)
    # Largest factor, up or down, between the scatter of the points of one image and that of its
    # camera.
    noisiest_image: float = 4.0
    # Weight of the camera's scatter in the estimate for one image, as a number of degrees of
    # freedom. On 13 public sets the logarithm of the images' scatter has a standard deviation of
    # .17 to .55.
    image_prior: float = 20.0
    # Smallest share of consistent points in an image. Below it, the board's pose in the image
    # contradicts the shot. By hand.
    fewest_agree: float = 0.5
    # Largest factor by which an estimated board shape may change focal lengths. Bound by hand: a
    # public set of unsynchronised cameras (spenc) needs 1.4.
    largest_focal_change: float = 2.0
    # Largest scatter of the shots that multiplies the prior of the board shape. Bound by hand.
    largest_scatter: float = 25.0
    # An image was taken at another time than its shot if its board pose differs by more than this
    # factor from the usual difference, in chi-square per degree of freedom (three times as far).
    # Simultaneous pairs of one public set (semeniuta) reach 8, others begin at 1,700. If a third
    # of few shots are wrong, they raise the usual difference, and begin at 7.
    other_moment: float = 9.0
    # The cameras of a rig are not synchronised if the same ratio, against the noise of the images
    # about their own poses, has a larger median over the shots. Six public sets with a common
    # trigger have .6 to 13, three pairs without one 28 to 62.
    moments_differ: float = 20.0
    # A chi-square is refuted if it exceeds its degrees of freedom by this many of its standard
    # deviations. Sigmas are then enlarged, or the board's points are estimated. By hand.
    refuted_sigmas: float = 4.0
    # The same for the pulls of whole shots. By hand.
    shots_sigmas: float = 3.0
    # Initial standard deviation of the board's points, over the remaining residual of the fit. By
    # hand.
    first_spread: float = 3.0
    # Standard deviation of the angle between the sides of a print from 90 degrees, rad. Twice the
    # relative stretch of one side; by hand.
    shear: float = 1e-3
    # Standard deviations of the terms of second, third and fourth degree of a sheet's height, over
    # its flatness. Paper from a roll changes its curvature by a part of it. By hand.
    height_shares: tuple[float, float, float] = (1.0, 0.5, 0.25)


@dataclass(frozen=True)
class StartTuning:
    """Tuned constants for initial lenses and initial poses of cameras and boards.

    Chosen by hand. Check with the excluded shots and the lenses in benchmarks/rigs.py.
    """

    # Initial focal lengths over the longer side of the image: if Zhang's formula yields none, and
    # for a fisheye.
    focal_shares: tuple[float, ...] = (0.7, 1.4, 3.0, 8.0)
    fisheye_shares: tuple[float, ...] = (0.2, 0.25, 0.3, 0.36, 0.45, 0.55, 0.7, 1.0, 1.4)
    # Largest distance of a point from the homography of its image, as a share of the board's
    # extent there. Lens distortion causes less; the point was located wrongly.
    gross_share: float = 0.05
    # Largest distance of a board from its predicted position, as the same share. Initial lenses are
    # wrong by a few percent.
    elsewhere_share: float = 0.06
    # Lower limit of both distances, px.
    least_px: float = 3.0
    # Rotations about one axis do not determine the translation along it. Smallest rotation about
    # other axes, as a share of that about the main axis.
    least_other_turns: float = 0.05
    # Smallest angle between the planes of boards. Nearly parallel boards do not separate focal
    # length from distance.
    parallel_deg: float = 8.0
    # Largest shift of the shot numbers of one camera that is tried if cameras may be numbered
    # differently.
    most_shift: int = 3


@dataclass(frozen=True)
class AdviceTuning:
    """Tuned constants for advice on the next shot, and for the comparison of two calibrations.

    Each of these two calibrations uses one half of the shots. Chosen by hand.
    """

    # The two halves are compared at the distances of the boards, and this many times as far, where
    # errors of lens and pose no longer cancel.
    farther: float = 3.0
    # Poses proposed for the board: its tilt; its extents as shares of the shorter side of the
    # image; and the margin to the edge of the image, as the same share, for boards off the centre.
    tilt_deg: float = 40.0
    fills: tuple[float, ...] = (0.35, 0.6)
    margin: float = 0.05
    # Smallest visible share of a board's points with which it is used (a chessboard needs all).
    least_seen: float = 0.6
    # Largest angle between the line of sight and the board's normal.
    most_oblique_deg: float = 65.0
    # Number of proposed shots that are evaluated: those of which the rig is most uncertain.
    most_compared: int = 40
    # Prior standard deviation of undetermined directions, in the steps of their unknowns. It makes
    # advice possible; no covariance that leaves this package contains it.
    prior_sigma: float = 3.0


@dataclass(frozen=True)
class AdjustmentTuning:
    """Tuned constants for the choice between the estimates by circles and by grey levels.

    Chosen by hand. Check with benchmarks/picture_conditions.py.
    """

    # Another initial pose of a camera is tried if the median residual of its circles exceeds this,
    # in sigmas.
    far_sigmas: float = 10.0
    # Lower limit of the covariance of the difference between both estimates, as a share of the
    # circles' covariance. The reported covariances vary by this much from image to image.
    least_difference: float = 0.3
    # Number of blocks along each side of the sheet for the jackknife, and the fewest blocks with
    # circles from which a scatter is estimated.
    blocks: int = 4
    fewest_blocks: int = 6


@dataclass(frozen=True)
class BundleTuning:
    """Tuned constants of the refinement with matched segments.

    They concern robust weights and the choice among several solutions. Check with errors and
    coverage of benchmarks/refine.py. The part `matched` of this benchmark checks the last six
    constants.
    """

    # Distance in sigmas at which the loss of a fragment saturates. By hand.
    loss_sigmas: float = 4.0
    # Factors on this distance from round to round: at first all fragments have weight, at last
    # only the consistent ones. By hand.
    widenings: tuple[float, ...] = (16.0, 4.0, 1.0)
    # Probability that a correct fragment is rejected as an outlier. By hand.
    outlier_chance: float = 1e-3
    # Smallest redundancy from which the sigmas of the sheet are rescaled. With less, the factor
    # would be wrong by 13 % or more. By hand.
    fewest_for_sheet: int = 30
    # Initial poses of the search: a camera is rotated by the largest knock that the search is
    # designed for, degrees. A camera aimed at the origin is moved around it instead, which
    # preserves the images of near objects. By hand.
    turn_deg: float = 1.2
    round_deg: float = 5.0
    # The search is not needed if the sheet determines a camera's orientation to this share of
    # `turn_deg`. By hand.
    known_share: float = 0.25
    # Two solutions are equal if their lines differ by less than this, in sigmas. By hand.
    same_sigmas: float = 3.5
    # A solution is unique if no other comes within this factor of its log posterior. Next to wrong
    # solutions another one is within 1.35 in 5 of 6 cases; next to correct ones none of 45 is
    # within 1.52. Made scenes, seeds from 150,000.
    clear_factor: float = 1.45


@dataclass(frozen=True)
class RigCheckTuning:
    """Tuned constants for the comparison of a rig with an earlier calibration or with images.

    Check with the rigs of benchmarks/refine.py in which a camera was moved ("knocked").
    """

    # A camera has moved since an earlier calibration if its pose differs by more sigmas. Noise
    # causes this once in 10^5 comparisons. By hand.
    moved_sigmas: float = 4.5
    # Smallest change reported if neither rig has sigmas. By hand.
    quiet_mm: float = 0.1
    quiet_deg: float = 0.01
    # Images were exchanged if the pose of another camera fits this many times better. By hand.
    swap_ratio: float = 10.0
    # Fewest sigmas of a motion estimated from images of a scene. Of rigs of three cameras at rest,
    # one in 120 exceeds it. By hand.
    suspect_sigmas: float = 3.0
    # Fewest lines that determine the six parameters of a camera. By hand.
    fewest_lines: int = 12
    # Largest scatter of the lines over their reported sigmas. Chance matches scatter 1.2 to 2.3
    # times, correct ones 0.9 to 1.1. Above it, the scene is matched again; if that is impossible,
    # it is not used. Made scenes.
    most_noise: float = 1.5
    # If this share of every view's segments is on reliable tracks of three views, no knock prevents
    # the matching. As `clear_share` of matching.
    clear_share: float = 0.5


@dataclass(frozen=True)
class AnswerTuning:
    """Tuned constants for the status of a calibration, and thresholds of its warnings.

    Chosen by hand unless a comment gives another source. Check with
    benchmarks/picture_conditions.py and benchmarks/rigs.py.
    """

    # Probability under noise below which images contradict a fixed parameter, or an aim.
    chance: float = 1e-4
    # The same if the change would move the camera by more than `strain_sigmas`. One correct image
    # in 300 is then SUSPECT; of eight images through a lens wrong by .05 %, six instead of four.
    chance_where_strained: float = 1e-3
    # The same for the score test of additional lens coefficients.
    chance_of_lens: float = 1e-3
    # The same for the difference of the estimates by circles and by grey levels, and for the
    # correlation of neighbouring circles whose residuals exceed their noise.
    chance_of_answers: float = 1e-2
    # Probability with which a test must detect an error; a smaller error counts as undetected.
    # Baarda's value, by hand.
    power: float = 0.8
    # Largest scatter of blocks of circles over the expected one; correct images exceed it once in
    # some hundreds.
    largest_scatter: float = 1.5
    # Shift of points below which the profile of an edge does not change visibly, px.
    least_shift_px: float = 0.02
    # Spread of ink below which circle centres move by less than their sigmas, mm.
    least_spread_mm: float = 0.01
    # A lens model is worse if its errors on held-out shots are larger by this many standard
    # deviations of their mean difference.
    worse_sigmas: float = 2.0
    # Limit of a shot's error in this comparison, over the best lens's median.
    cap: float = 5.0
    # Fewest points from which a lens is estimated.
    fewest_points: int = 8
    # Largest rms residual as a share of the sheet's extent in the image, and of a board's extent if
    # its lens is estimated. Above it, the model is wrong. Lower limit of both, px.
    misfit_share: float = 0.01
    misfit_share_of_lens: float = 0.003
    least_misfit_px: float = 1.0
    # A pattern in the residuals is reported if it exceeds this many times the pattern of noise, and
    # this share of all residuals.
    named_ratio: float = 2.5
    named_share: float = 0.4
    # A camera has moved during the shots if its shifts jump by this many times their scatter.
    moved_scatters: float = 8.0
    # A rig is SUSPECT if the residuals multiply its sigmas by more than this.
    largest_sigma_factor: float = 3.0
    # Reduced chi-square above which it is reported, and the same for the share of excluded pixels.
    large_chi_square: float = 2.0
    cut_share: float = 0.01
    # The images contradict a given sheet, board or lens if its estimate differs by more of the
    # given sigmas.
    strain_sigmas: float = 4.0
    # Coefficients with which a distortion folds the image are fixed at 0 if the rms residual grows
    # by no more than this factor. It grows by 1.07 for a T265 fisheye, whose focal length then
    # changes by .2 %, and by 4.6 for a made lens, whose principal point moves by 24 px.
    most_rise_by_fixing: float = 1.2
    # Smallest share of a prior's variance that the images must remove in a direction, for the
    # distance from the prior to be tested. Below it, errors of the images are magnified.
    least_share_of_prior: float = 0.1
    # Two unknowns cannot be separated if the correlation of their distances from the priors
    # exceeds this, and if the smaller distance is at least this share of the larger, in sigmas.
    inseparable: float = 0.9
    # Smallest distance between aim and origin that is reported, mm.
    least_aim_mm: float = 0.01
    # Smallest share of the way from the centre to the corners of the image that points must reach
    # to determine a distortion.
    enough_reach: float = 0.8
    # A more precise lens or print is recommended if priors narrowed `better_known` times would
    # narrow the sigmas `enough_gain` times (geometric mean over the parameters). A calibrated lens
    # exceeds ten times.
    better_known: float = 10.0
    enough_gain: float = 1.5


@dataclass(frozen=True)
class CalibTuning:
    """All groups of tuned constants of calibration.

    Benchmarks and docs report results with the default values.
    """

    targets: TargetTuning = field(default_factory=TargetTuning)
    detection: DetectionTuning = field(default_factory=DetectionTuning)
    photometric: PhotometricTuning = field(default_factory=PhotometricTuning)
    uncertainty: UncertaintyTuning = field(default_factory=UncertaintyTuning)
    problem: ProblemTuning = field(default_factory=ProblemTuning)
    starts: StartTuning = field(default_factory=StartTuning)
    advice: AdviceTuning = field(default_factory=AdviceTuning)
    adjustment: AdjustmentTuning = field(default_factory=AdjustmentTuning)
    bundle: BundleTuning = field(default_factory=BundleTuning)
    rig_check: RigCheckTuning = field(default_factory=RigCheckTuning)
    answer: AnswerTuning = field(default_factory=AnswerTuning)


TUNING = CalibTuning()
