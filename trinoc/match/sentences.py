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
        f'The cameras "{first}" and "{second}" are only {baseline_mm:.2g} mm apart{more}: '
        f"{100 * share:.0f} % of their longest segments coincide as if the scene were infinitely "
        "far away, so this pair gives no depth. Move one of the cameras, or check the rig."
    )


def segments_beyond_fold(counts: Mapping[str, int], radius_px: Mapping[str, float]) -> str:
    """Return the warning that segments are excluded because the lens model is not invertible there.

    `counts` and `radius_px` are, for each view, the number of excluded segments and the largest
    invertible radius.
    """
    beyond = ", ".join(
        f'{count} of "{name}" (beyond {radius_px[name]:.0f} px)' for name, count in counts.items()
    )
    return (
        "Segments are excluded because they lie outside the radius within which the lens model is "
        f"one to one: {beyond}. To use them, calibrate with the board nearer to the image corners."
    )


def triples_discarded(count: int) -> str:
    """Return the warning that there were more likely triples than the memory limit allows.

    `count` is the number of discarded triples.
    """
    return (
        f"{count} likely triples were discarded to limit the memory, because the images contain "
        "repeated structure. The posteriors of their rivals are lowered by their share. Exclude "
        "the shortest segments, or match parts of the images."
    )


def noise_differs(scale: float) -> str:
    """Return the warning that the estimated noise differs from the stated noise.

    `scale` is the estimated sigma of the segments over the stated one.
    """
    return (
        f"The errors of the segments are {scale:.2g} times the stated sigma, and all covariances "
        f"use this estimate. Pass a sigma_px that is {scale:.2g} times the stated one, so that the "
        "candidate search uses it too."
    )


def cameras_collinear(unlocated: int) -> str:
    """Return the warning that the centres of all cameras lie on one line.

    `unlocated` is the number of tracks that are excluded for this reason.
    """
    return (
        "The cameras' centres lie on one line, and no pair of views locates segments that are "
        f"parallel to it: {unlocated} tracks are excluded. Move one camera off the line."
    )


def two_views_leave_unlocated(unlocated: int) -> str:
    """Return the warning that two views do not determine the depth of segments along epipolar
    lines.

    `unlocated` is the number of tracks that are excluded for this reason.
    """
    return (
        "Two views do not locate segments along their epipolar lines: "
        f"{unlocated} tracks are excluded. Add a third camera off the line through the two."
    )


def set_does_not_belong(sure: int, by_chance: float | None, remedy: str) -> str:
    """Return the warning that the segments do not seem to belong to the rig.

    Parameters
    ----------
    sure : int
        Number of sure lines in three views.
    by_chance : float or None
        Mean number of sure lines of the decoys. None if no decoy was matched.
    remedy : str
        Sentence with the most likely cause or the remedy.
    """
    decoys = (
        "" if by_chance is None else f", and {by_chance:.0f} with one image mirrored on purpose"
    )
    return (
        "These segments and this rig do not seem to belong together: there are "
        f"{sure} sure lines in three views{decoys}. {remedy}"
    )


CHECK_THE_SET = (
    "Check that this rig took these images of one scene at one time, in the size that it states, "
    "and that each image has the name of its own camera."
)


def rig_has_changed(sure: int, segments: int, noise_scale: float) -> str:
    """Return the warning that a camera was probably moved.

    The evidence is that only `sure` of `segments` segments are sure, with large errors.
    `noise_scale` is the estimated sigma of the segments over the stated one.
    """
    return (
        f"Only {sure} of {segments} segments are sure in three views, and their errors are "
        f"{noise_scale:.2g} times the stated sigma: a camera was moved, or an image is cropped or "
        "shifted. Check the rig (check_rig) before you use these matches."
    )


# Mistakes that explain a suspect set.


def most_likely_mistake(description: str, corrected: int, uncorrected: int) -> str:
    """Return the sentence that names the mistake that was probably made.

    `description` is the clause of the mistake. `corrected` and `uncorrected` are the numbers of
    sure lines with and without its correction, for a sample of the segments.
    """
    return (
        f"Most likely {description}: after correction, {corrected} lines of a sample are sure, "
        f"instead of {uncorrected}."
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
    return f'the segments of "{view}" come from an image of {size} the size of its camera\'s'


def all_images_resized(size: str) -> str:
    """Return the clause that the segments of all views come from scaled images.

    `size` is "half" or "twice".
    """
    return f"the segments come from images of {size} the size of the cameras'"


def image_shifted(view: str, shift_px: Float[ndarray, "2"]) -> str:
    """Return the clause that the image of a view is shifted relative to its camera in the rig.

    `shift_px` is the shift (u, v).
    """
    return (
        f'the image of "{view}" is shifted by about ({shift_px[0]:.0f}, {shift_px[1]:.0f}) px '
        "against its camera (it is cropped, or its principal point or the camera has moved)"
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
        f"{before} before them. Give the matrices of unmirrored images in a right-handed world."
    )


def camera_mirrored(name: str, reason: str) -> str:
    """Return the error message that a camera is mirrored or looks away from the scene.

    `reason` is the evidence: NEGATIVE_DETERMINANT or SCENE_BEHIND.
    """
    return (
        f'Camera "{name}" is mirrored or looks the wrong way ({reason}): give the matrix of the '
        "unmirrored image in a right-handed world, with x to the right and y down."
    )


NEGATIVE_DETERMINANT = "its rotation has determinant -1"
SCENE_BEHIND = "the space that it shares with the other cameras lies behind it"

# Findings on whether matches can be used: explanation, then remedy.


def depth_range_excludes(segments: int) -> str:
    """Return the advice that follows if the depth range excludes more segments than are matched.

    `segments` is the number of excluded segments.
    """
    return (
        f"{segments} segments have no partner within the allowed depths: check depth_range_mm, "
        "which is measured from each camera, in mm."
    )


def calibration_suspect(camera: str, reason: str) -> str:
    """Return the explanation that the calibration of a camera was suspect.

    `reason` is a sentence from the calibration, or "".
    """
    sentence = f"{reason[:1].upper()}{reason[1:]}"
    return f"the calibration of {camera} was suspect. {sentence}".rstrip()


CALIBRATE_AGAIN = (
    "The 3-D segments inherit this error, and their sigmas do not include it: calibrate again."
)
REMOVE_THE_CAUSE = "No posterior here is above 0.5: remove the cause and match again."
DO_NOT_BELONG = "segments and rig do not belong together."


def only_two_views(tracks: int) -> str:
    """Return the explanation that no third view confirms the tracks.

    `tracks` is the number of tracks.
    """
    return (
        f"of {tracks} tracks. Chance gives lines in two views too, and no third view separates "
        "these from right ones."
    )


ADD_A_CAMERA = "Check that this rig took these images, or add a third camera."


def sure_lines(tracks: int, share: float) -> str:
    """Return the explanation of the number of sure lines.

    `tracks` is the number of all tracks. `share` is the share of segments on sure lines, 0 to 1, in
    the view with the smallest share.
    """
    return (
        f"of {tracks} tracks, which contain {100 * share:.0f} % of the segments of the view with "
        "the fewest matches."
    )


def too_few_sure_lines(required: int) -> str:
    """Return the advice that follows if there are too few sure lines.

    `required` is the smallest number of sure lines.
    """
    return (
        f"{required} are needed: check that this rig took these images of one scene, that each "
        "image has the name of its own camera, and that no camera was moved (trinoc check)."
    )


VIEWS_DISAGREE_BY = (
    "the disagreement between the views about a segment's position. Near 1, they agree as well "
    "as the segments were measured."
)
CHECK_THE_ERRORS = (
    "A camera may have been moved (run trinoc check), the images are sharpened or were displaced, "
    "or the stated sigma of the segments is too small. The sigmas of the lines include this factor."
)


def sigma_of_lines(count: int, extent: str) -> str:
    """Return the explanation of the median sigma of the sure lines.

    `count` is the number of sure lines. `extent` is the diameter of a ball with nine tenths of
    their ends, as text with unit.
    """
    return (
        f"the median sigma across the {count} sure lines, nine tenths of whose ends lie within "
        f"{extent}."
    )


REDUCE_THE_SIGMA = (
    "Put the cameras farther apart or nearer to the scene, or use images with more pixels. If the "
    "positions are still good enough for you, each line has its own covariance."
)

# Line ends that do not fit the wire frame.


def end_misses_near_corner(distance_mm: float, chi_square: float) -> str:
    """Return the sentence that the line of a free end does not pass through the corner near the
    end.

    `chi_square` is that of the distance from the corner, with 2 degrees of freedom.
    """
    return (
        f"its line misses the corner beside its end by {distance_mm:.2f} mm: chi-square "
        f"{chi_square:.0f} with 2 degrees of freedom. The end stays free."
    )


def end_leaves_corner(chi_square: float, degrees: int) -> str:
    """Return the sentence that a line does not pass through the corner that its end was joined to.

    `chi_square` and `degrees` are the misfit of the end to the corner.
    """
    return (
        f"its line does not pass through the corner at its end: chi-square {chi_square:.0f} with "
        f"{degrees} degrees of freedom. The end was made free."
    )
