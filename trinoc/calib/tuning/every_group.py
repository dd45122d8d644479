"""All groups of tuned constants of calibration as one value."""

from dataclasses import dataclass, field

from trinoc.calib.tuning.detection import DetectionTuning
from trinoc.calib.tuning.photometric import PhotometricTuning


@dataclass(frozen=True)
class TargetTuning:
    """The sheet that suits a camera, and sizes that cannot be. By hand."""

    # A proposed sheet takes so large a share of the field's shorter side: room is left for aiming,
    # and for the sheet to be seen aslant.
    field_share: float = 0.6
    # Its circles are so wide in the picture, px, or at least so wide; their radius is this share
    # of the pitch; which is a multiple of this, mm.
    good_px: float = 20.0
    least_px: float = 10.0
    radius_share: float = 0.3
    step_mm: float = 0.5
    # Printers miss a length by a percent; by so large a share a person or the unit does.
    largest_change: float = 0.3
    # Centres of a measured sheet lie so far, in pitches, from an even lattice.
    off_lattice: float = 0.25


@dataclass(frozen=True)
class UncertaintyTuning:
    """What is assumed of sheet, aim and lens where nobody says it: see `Systematics.typical`. All
    standard deviations by hand; shown by the coverage of benchmarks/calibration_conditions.py."""

    # Of the whole print's size, and of each side beside that, as shares.
    print_size: float = 2e-3
    # 1 % between X and Y then lies within four sigmas: one image hardly shows it, and with 7e-4 it
    # moved the pan by 10 sigma without a word.
    print_stretch: float = 2e-3
    # Of a sheet's height at its edge, and of the point that a camera is aimed at, mm.
    flatness_mm: float = 0.3
    aim_mm: float = 20.0
    # Of a data sheet: focal length, its aspect, the principal point over the picture's width, and
    # distortion at the corner, px.
    focal_length: float = 1e-2
    aspect: float = 2e-3
    principal_point: float = 2e-2
    distortion_px: float = 1.0


@dataclass(frozen=True)
class ProblemTuning:
    """What noise makes and what not: of a place, a picture, a camera's sigmas, the board. Shown by
    errors and coverage of benchmarks/rigs.py and benchmarks/calibration.py."""

    # A place farther off, in robust standard deviations, was located wrongly: noise makes it once
    # in 10^8. By hand.
    gate: float = 6.0
    # Scales, in robust standard deviations, at which the influence of a place is bounded from round
    # to round. By hand.
    annealing: tuple[float, ...] = (30.0, 10.0, 5.0)
    # Places of one image scatter at most so many times as much as those of its camera, or as much
    # less; the camera's scatter counts as so many numbers beside the image's own. On 13 public sets
    # the logarithms of the images' scatter have a standard deviation of .17 to .55.
    noisiest_image: float = 4.0
    image_prior: float = 20.0
    # A picture of which a smaller share of places agrees shows the board elsewhere. By hand.
    fewest_agree: float = 0.5
    # A shape of the board changes focal lengths by at most this factor, and its prior is multiplied
    # by no more than so large a scatter of the shots. Bounds by hand: a public set with cameras out
    # of step (spenc) needs 1.4 of the first.
    largest_focal_change: float = 2.0
    largest_scatter: float = 25.0
    # An image is of another moment than its shot where the pose of the board differs by more than
    # so many times what is usual among the shots, in chi-square per degree of freedom: three times
    # as far. Pairs of one public set (semeniuta) of one moment reach 8, others begin at 1,700;
    # where a third of few shots are others, they spoil the rig and what is usual, and begin at 7.
    other_moment: float = 9.0
    # The cameras of a rig do not look at one moment where the same, in the median of all shots and
    # over the noise of the images about their own poses, is so large: four times as far as noise.
    # Six public sets of cameras with a common trigger have .6 to 13, three pairs without 28 to 62.
    moments_differ: float = 20.0
    # A chi-square so many of its own standard deviations above its degrees of freedom is not noise:
    # sigmas grow, or a board's places are free. By hand.
    refuted_sigmas: float = 4.0
    # The same of the pulls of whole shots. By hand.
    shots_sigmas: float = 3.0
    # The first guess of how far a board's places lie off, over what is left of the fit. By hand.
    first_spread: float = 3.0
    # Standard deviation of the shear of a print: its sides are perpendicular to this angle, rad. As
    # twice the stretch of one side; by hand.
    shear: float = 1e-3
    # Heights of second, third and fourth degree of a sheet against its flatness: paper that was
    # rolled changes its curvature by a part of it. By hand.
    height_shares: tuple[float, float, float] = (1.0, 0.5, 0.25)


@dataclass(frozen=True)
class StartTuning:
    """First lenses, and cameras and boards chained into one frame. By hand; shown by the shots
    that are refused, and by lenses that are found, in benchmarks/rigs.py."""

    # Focal lengths to start from, in longer sides of the picture: where Zhang's formula has none,
    # and of a fisheye.
    focal_shares: tuple[float, ...] = (0.7, 1.4, 3.0, 8.0)
    fisheye_shares: tuple[float, ...] = (0.2, 0.25, 0.3, 0.36, 0.45, 0.55, 0.7, 1.0, 1.4)
    # A place that lies farther off its picture's homography, as a share of the board's extent
    # there, was located wrongly: lenses bend less.
    gross_share: float = 0.05
    # A board that lies farther off, as such a share, stands elsewhere: first lenses are a few
    # percent off. Either is at least so many pixels.
    elsewhere_share: float = 0.06
    least_px: float = 3.0
    # Turns about one axis leave open how far cameras lie along it: those about others have at least
    # this share of them.
    least_other_turns: float = 0.05
    # Boards whose planes differ by less look parallel: focal length and distance look alike then.
    parallel_deg: float = 8.0
    # Cameras whose pictures were counted differently are tried so many shots apart.
    most_shift: int = 3


@dataclass(frozen=True)
class AdviceTuning:
    """Shots that are foreseen, and where two halves of the shots are compared. By hand."""

    # Points are compared where the boards were, and so many times as far, where errors of lens and
    # pose no longer cancel.
    farther: float = 3.0
    # How the board may be held: tilted by so many degrees, with so large a share of the picture's
    # shorter side, and with such a share left around it where it is held aside.
    tilt_deg: float = 40.0
    fills: tuple[float, ...] = (0.35, 0.6)
    margin: float = 0.05
    # A board that is seen in part tells by so large a share of its places (a chessboard by all),
    # and by none that is seen farther from its normal.
    least_seen: float = 0.6
    most_oblique_deg: float = 65.0
    # So many shots are compared: those of which the rig tells least.
    most_compared: int = 40
    # What the pictures do not determine is taken to be known to so many of its steps beforehand,
    # so that advice is possible; no covariance that leaves the room contains it.
    prior_sigma: float = 3.0


@dataclass(frozen=True)
class AdjustmentTuning:
    """Which answer of a picture is believed. Shown by benchmarks/picture_conditions.py."""

    # A camera is started another way where half of its circles lie farther off, in sigmas. By hand.
    far_sigmas: float = 10.0
    # The difference of two answers has at least this share of the circles' covariance: what they
    # claim differs by so much from picture to picture. By hand.
    least_difference: float = 0.3
    # Blocks along each side of the sheet that are left out in turn, and the fewest with circles
    # that tell how blocks scatter. By hand.
    blocks: int = 4
    fewest_blocks: int = 6


@dataclass(frozen=True)
class BundleTuning:
    """Which fragments are believed, and which of several answers. Shown by errors and coverage of
    benchmarks/refine.py, the last six by its part `matched`."""

    # What a fragment can cost, as a distance in sigmas; and how many times wider the loss is, from
    # round to round: first everything speaks, then only what fits. By hand.
    loss_sigmas: float = 4.0
    widenings: tuple[float, ...] = (16.0, 4.0, 1.0)
    # Right fragments lie farther off than those that are kept with this probability. By hand.
    outlier_chance: float = 1e-3
    # With less redundancy the sheet's own claim is kept: a factor from it would be off by 13 % or
    # more. By hand.
    fewest_for_sheet: int = 30
    # The search starts with a camera turned by the largest knock that it is meant for, degrees, or,
    # if it aims at the origin, taken round it, where pictures of what lies near stay. By hand.
    turn_deg: float = 1.2
    round_deg: float = 5.0
    # A camera whose orientation the sheet knows to this share of `turn_deg` cannot stand
    # elsewhere. By hand.
    known_share: float = 0.25
    # Two answers are one where the lines of one miss each other by less with the other. By hand.
    same_sigmas: float = 3.5
    # An answer is clear where no other comes within this factor in log posterior: beside wrong ones
    # within 1.35 in 5 of 6, beside right ones none of 45 within 1.52. Made scenes, from 150,000 on.
    clear_factor: float = 1.45


@dataclass(frozen=True)
class RigCheckTuning:
    """A calibration against an earlier one, and a rig against scene pictures. Shown by the
    knocked rigs of benchmarks/refine.py."""

    # A camera has moved since an earlier calibration beyond so many sigmas: once in 10^5
    # comparisons of it by noise alone. By hand.
    moved_sigmas: float = 4.5
    # Where neither rig has sigmas, changes up to these say nothing. By hand.
    quiet_mm: float = 0.1
    quiet_deg: float = 0.01
    # Pictures were swapped when the other camera's place fits so many times better. By hand.
    swap_ratio: float = 10.0
    # Below so many sigmas a motion of scene pictures may be chance: of three cameras that stand
    # still, one rig in 120 is suspected. By hand.
    suspect_sigmas: float = 3.0
    # Fewer lines are hardly enough for the six numbers of a camera. By hand.
    fewest_lines: int = 12
    # Lines that scatter more than so many stated sigmas are joined by chance: such scatter 1.2 to
    # 2.3 times, right ones 0.9 to 1.1. Such a scene is matched again, or where it cannot be,
    # decides nothing. Made scenes.
    most_noise: float = 1.5
    # Where so large a share of every view's segments is on sure tracks of three views, no knock
    # hides the scene from the matcher. As `clear_share` of matching.
    clear_share: float = 0.5


@dataclass(frozen=True)
class AnswerTuning:
    """Which answer is given, and what a message says of it. By hand where nothing else is said;
    shown by benchmarks/picture_conditions.py and benchmarks/rigs.py."""

    # Where noise makes so much with less than this probability, pictures speak against what a model
    # holds fixed, and against an aim.
    chance: float = 1e-4
    # The same where the change would move the camera by more than `strain_sigmas`: one fair image
    # in 300 is SUSPECT; of eight images through a lens .05 % off, six and not four.
    chance_where_strained: float = 1e-3
    # The same of a score test that calls for more coefficients of a lens.
    chance_of_lens: float = 1e-3
    # The same of two answers of a picture, by circles and by grey levels, that differ so much, and
    # of circles far beyond their noise, whose neighbours err so much alike.
    chance_of_answers: float = 1e-2
    # An error that the test at `chance` finds less often goes unseen. Baarda's share, by hand.
    power: float = 0.8
    # Blocks of right circles scatter so many times as much as claimed once in hundreds of pictures.
    largest_scatter: float = 1.5
    # Shifts of places by less, px, do not bend an edge's profile: pictures say nothing new.
    least_shift_px: float = 0.02
    # Ink that spreads less, mm, moves the centres of circles by less than they are known to.
    least_spread_mm: float = 0.01
    # A lens is worse where its errors on held-out shots are larger by so many standard deviations;
    # none counts beyond so many times the best lens's median.
    worse_sigmas: float = 2.0
    cap: float = 5.0
    # Fewer points do not tell a lens.
    fewest_points: int = 8
    # Root mean square misfits beyond this share of what the sheet takes of the picture, and of a
    # board whose lens is fitted, are of another model; they are at least so many px.
    misfit_share: float = 0.01
    misfit_share_of_lens: float = 0.003
    least_misfit_px: float = 1.0
    # A pattern in the residuals is named where it is so many times what noise leaves of it, and
    # this share of all residuals; a camera moved where its shifts jump by so many times their
    # scatter.
    named_ratio: float = 2.5
    named_share: float = 0.4
    moved_scatters: float = 8.0
    # Sigmas that the residuals multiply by more than this make a rig SUSPECT.
    largest_sigma_factor: float = 3.0
    # Beyond this, a reduced chi-square is told; and a share of pixels that were left out.
    large_chi_square: float = 2.0
    cut_share: float = 0.01
    # Sheet, board or lens is another than was said beyond so many of the stated sigmas.
    strain_sigmas: float = 4.0
    # Coefficients with which a distortion folds the picture are fixed at 0 where the rms residual
    # grows by no more than this factor. It grows by 1.07 for a T265 fisheye, whose focal length
    # then moves by .2 %, and by 4.6 for a made lens, whose principal point moves by 24 px.
    most_rise_by_fixing: float = 1.2
    # Of the variance of a prior, the least share that the images must remove in a direction for its
    # distance from the prior to be tested: below, errors of the images count many times.
    least_share_of_prior: float = 0.1
    # Two unknowns with a larger correlation of their distances from their priors, and distances
    # that differ by a smaller share, cannot be separated.
    inseparable: float = 0.9
    # An aim closer to the origin, mm, is not reported.
    least_aim_mm: float = 0.01
    # A distortion is held by places that reach this share of the way to the corners.
    enough_reach: float = 0.8
    # Knowing lens or print so many times as well is worth saying where it narrows sigmas by this
    # factor, the geometric mean over the parameters. A calibrated lens surpasses ten.
    better_known: float = 10.0
    enough_gain: float = 1.5


@dataclass(frozen=True)
class CalibTuning:
    """All groups; the default is what everything was measured with."""

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
