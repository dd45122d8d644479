"""Sentences that the matcher reports: numbers and names in, text out, and no decisions.

In this order: notes on a set of matches, mistakes that explain a suspect set, mirrored cameras,
findings on whether matches can be used, and unfitted ends of a wire frame.
"""

from collections.abc import Iterable, Mapping

from jaxtyping import Float
from numpy import ndarray

from trinoc.errors import list_names

# Notes on a set of matches.


def cameras_nearly_coincide(
    pair: tuple[str, str], baseline_mm: float, share: float, further_pairs: int
) -> str:
    """Return the warning that two cameras are too close together to determine depth.

    Parameters
    ----------
    pair : (str, str)
        Names of the two cameras.
    baseline_mm : float
        Distance between the two cameras.
    share : float
        Share of the longest segments that match at infinite depth, 0 to 1.
    further_pairs : int
        Number of other pairs of cameras with this problem.
    """
    first, second = sorted(pair)
    more = f" (and {further_pairs} more pairs of cameras)" if further_pairs else ""
    return (
        f'The cameras "{first}" and "{second}" are only {baseline_mm:.2g} mm apart{more}, so they '
        f"give no depth: {100 * share:.0f} % of their longest segments match at infinite distance. "
        "Move one of the cameras, or check the rig."
    )


def segments_beyond_fold(counts: Mapping[str, int], radius_px: Mapping[str, float]) -> str:
    """Return the warning that segments are excluded because the lens model is not invertible there.

    `counts` and `radius_px` are, for each view, the number of excluded segments and the largest
    invertible radius.
    """
    excluded = ", ".join(
        f'{count} segments of "{name}" beyond {radius_px[name]:.0f} px'
        for name, count in counts.items()
    )
    return (
        "The lens model is not one to one far from the principal point, and segments there are "
        f"excluded: {excluded}. To use these segments, calibrate with the board nearer to the "
        "image corners."
    )


def triples_discarded(count: int) -> str:
    """Return the warning that there were more likely triples than the memory limit allows.

    `count` is the number of discarded triples.
    """
    return (
        f"{count} likely triples of segments were discarded to limit the memory, because the "
        "images contain repeated structure. The posteriors of other triples of these segments are "
        "lowered. Exclude the shortest segments, or match parts of the images."
    )


def noise_differs(scale: float) -> str:
    """Return the warning that the estimated noise differs from the stated noise.

    `scale` is the estimated sigma of the segments over the stated one.
    """
    return (
        f"The estimated errors of the segments are {scale:.2g} times the stated sigma, and all "
        f"covariances use the estimate. Pass {scale:.2g} times the stated sigma_px, so that the "
        "search for candidates uses the estimate, too."
    )


def cameras_collinear(unlocated: int) -> str:
    """Return the warning that the centres of all cameras lie on one line.

    `unlocated` is the number of tracks that are excluded for this reason.
    """
    return (
        f"All camera centres lie on one line. {unlocated} tracks are excluded, because their "
        "segments are parallel to this line, so that no pair of views determines the depth. Move "
        "one camera off the line."
    )


def two_views_leave_unlocated(unlocated: int) -> str:
    """Return the warning that two views do not determine the depth of segments along epipolar
    lines.

    `unlocated` is the number of tracks that are excluded for this reason.
    """
    return (
        f"{unlocated} tracks are excluded, because two views do not determine the depth of "
        "segments along epipolar lines. Add a third camera off the line through the two cameras."
    )


def set_does_not_belong(sure: int, by_chance: float | None, remedy: str) -> str:
    """Return the warning that the segments do not seem to belong to the rig.

    Parameters
    ----------
    sure : int
        Number of lines matched in three views with a posterior above 0.9.
    by_chance : float or None
        Mean number of such lines when the image of one view is mirrored or upside down, so that all
        matches are wrong. None if this was not tried.
    remedy : str
        Sentence with the most likely cause or the remedy.
    """
    decoys = "" if by_chance is None else f", and wrong images give about {by_chance:.0f} by chance"
    return (
        f"The segments and the rig do not seem to belong together: matching gives {sure} sure "
        f"lines in three views{decoys}. {remedy}"
    )


CHECK_THE_SET = (
    "Check that this rig took these images of one scene at one time, that each image has the size "
    "that the rig states, and that each image has the name of its own camera."
)


def rig_has_changed(sure: int, segments: int, noise_scale: float) -> str:
    """Return the warning that a camera was probably moved.

    The evidence is that only `sure` of `segments` segments have a track with a posterior above 0.9
    in three views, and that the errors are large.
    `noise_scale` is the estimated sigma of the segments over the stated one.
    """
    return (
        f"Only {sure} of {segments} segments are sure in three views, and the errors of the "
        f"segments are {noise_scale:.2g} times the stated sigma, so a camera was moved, or an "
        "image is cropped or shifted. Check the rig (check_rig) before you use these matches."
    )


# Mistakes that explain a suspect set.


def most_likely_mistake(description: str, corrected: int, uncorrected: int) -> str:
    """Return the sentence that names the mistake that was probably made.

    `description` is the clause of the mistake. `corrected` and `uncorrected` are the numbers of
    sure lines (posterior above 0.9) with and without its correction, for a sample of the segments.
    """
    return (
        f"Probably {description}: a sample of the segments gives {uncorrected} sure lines, and "
        f"{corrected} sure lines without this mistake. Correct the mistake, and match again."
    )


def images_exchanged(views: Iterable[str]) -> str:
    """Return the clause that the images of some views have each other's names."""
    return f"the images of {list_quoted(views)} are exchanged"


def image_turned(view: str, change: str) -> str:
    """Return the clause that the image of a view is mirrored or upside down.

    `change` is "mirrored" or "upside down".
    """
    return f'the image of "{view}" is {change}'


def image_resized(view: str, size: str) -> str:
    """Return the clause that the segments of one view come from a scaled image.

    `size` is "half" or "twice".
    """
    return f'the segments of "{view}" come from an image of {size} the size that the rig states'


def all_images_resized(size: str) -> str:
    """Return the clause that the segments of all views come from scaled images.

    `size` is "half" or "twice".
    """
    return f"the segments come from images of {size} the size that the rig states"


def image_shifted(view: str, shift_px: Float[ndarray, "2"]) -> str:
    """Return the clause that the image of a view is shifted relative to its camera in the rig.

    `shift_px` is the shift (u, v).
    """
    return (
        f'the image of "{view}" is shifted by about ({shift_px[0]:.0f}, {shift_px[1]:.0f}) px '
        "relative to its camera (the image is cropped, or the principal point or the camera has "
        "moved)"
    )


def list_quoted(names: Iterable[str]) -> str:
    """Return the names in quotes, joined by "and"."""
    return " and ".join(f'"{name}"' for name in names)


# The cameras of the matched set.


def rig_mirrored(names: Iterable[str], before: int, behind: int) -> str:
    """Return the error message that more lines lie behind all cameras than in front of them.

    `before` and `behind` are the numbers of lines in front of the cameras and behind them.
    """
    return (
        f"The rig of {list_names(names)} is mirrored: {behind} lines lie behind its cameras and "
        f"{before} in front. Give the matrices of unmirrored images in a right-handed world."
    )


def camera_mirrored(name: str, reason: str) -> str:
    """Return the error message that a camera is mirrored or looks away from the scene.

    `reason` is the evidence: NEGATIVE_DETERMINANT or SCENE_BEHIND.
    """
    return (
        f'Camera "{name}" is mirrored or looks away from the scene ({reason}). Give the matrix of '
        "the unmirrored image in a right-handed world, with x to the right and y down."
    )


NEGATIVE_DETERMINANT = "its rotation matrix has determinant -1"
SCENE_BEHIND = "the space that the other cameras see lies behind this camera"

# Findings on whether matches can be used: explanation, then remedy.


def depth_range_excludes(segments: int) -> str:
    """Return the advice that follows if the depth range excludes more segments than are matched.

    `segments` is the number of excluded segments.
    """
    return (
        f"{segments} segments have no partner at a depth within depth_range_mm. Check "
        "depth_range_mm, the smallest and the largest depth from each camera, in mm."
    )


def calibration_suspect(camera: str, reason: str) -> str:
    """Return the explanation that the rig file marks the calibration of a camera as SUSPECT.

    `reason` is a sentence from the calibration, or "".
    """
    sentence = f"{reason[:1].upper()}{reason[1:]}"
    return f"the rig states that the calibration of {camera} is SUSPECT. {sentence}".rstrip()


CALIBRATE_AGAIN = (
    "The sigmas of the 3-D segments do not include the resulting error. Calibrate again."
)
REMOVE_THE_CAUSE = "No posterior of these matches is above 0.5. Remove the cause, and match again."
DO_NOT_BELONG = "the segments and the rig do not belong together."


def only_two_views(tracks: int) -> str:
    """Return the explanation that no third view confirms the tracks.

    `tracks` is the number of tracks.
    """
    return (
        f"there are {tracks} tracks, and some tracks may be wrong by chance, because no third view "
        "confirms them."
    )


ADD_A_CAMERA = "Check that this rig took these images, or add a third camera."


def sure_lines(tracks: int, share: float, posterior: float) -> str:
    """Return the explanation of the number of sure lines.

    Parameters
    ----------
    tracks : int
        Number of all tracks.
    share : float
        Part of the segments on sure lines, 0 to 1, in the view with the smallest part.
    posterior : float
        A line is sure above this posterior probability.
    """
    return (
        f"these are the matched lines with a posterior above {posterior:g}, of {tracks} in all. In "
        f"the view with the fewest, {100 * share:.0f} % of the segments belong to these lines."
    )


def too_few_sure_lines(required: int) -> str:
    """Return the advice that follows if there are too few sure lines.

    A line is sure if its posterior is above 0.9. `required` is the smallest number of sure lines.
    """
    return (
        f"At least {required} sure lines are needed. Check that this rig took these images of one "
        "scene, that each image has the name of its own camera, and that no camera was moved "
        "(trinoc check)."
    )


VIEWS_DISAGREE_BY = (
    "this is the rms difference between the views in the positions of the segments. If it is near "
    "1, the views agree within the sigmas of the segments."
)
CHECK_THE_ERRORS = (
    "Check the rig (trinoc check), check that the images were not sharpened or shifted, and that "
    "the stated sigma of the segments is large enough. The sigmas of the lines include this factor."
)


def sigma_of_lines(count: int, extent: str) -> str:
    """Return the explanation of the median sigma of the sure lines.

    `count` is the number of sure lines (posterior above 0.9). `extent` is the diameter of
    a ball with nine tenths of their ends, as text with unit.
    """
    return (
        f"this is the median sigma perpendicular to the {count} sure lines. Nine tenths of their "
        f"ends lie within {extent}."
    )


REDUCE_THE_SIGMA = (
    "To reduce the sigmas, put the cameras farther apart or nearer to the scene, or use images "
    "with more pixels. Each line has its own covariance: lines of a sufficient accuracy can be "
    "used."
)

# Line ends that do not fit the wire frame.


def end_misses_near_corner(distance_mm: float, chi_square: float) -> str:
    """Return the sentence that the line of a free end does not pass through the corner near the
    end.

    `chi_square` is that of the distance from the corner, with 2 degrees of freedom.
    """
    return (
        f"the line misses the corner near this end by {distance_mm:.2f} mm (chi-square "
        f"{chi_square:.0f} with 2 degrees of freedom), so the end was not joined to the corner."
    )


def end_leaves_corner(chi_square: float, degrees: int) -> str:
    """Return the sentence that a line does not pass through the corner that its end was joined to.

    `chi_square` and `degrees` are the misfit of the end to the corner.
    """
    return (
        f"the line misses the corner that this end was joined to (chi-square {chi_square:.0f} with "
        f"{degrees} degrees of freedom), so the end was separated from the corner."
    )
