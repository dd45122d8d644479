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
    """Two cameras are nearly at one position. `share` : of segments at infinite depth, 0 to 1."""
    first, second = sorted(pair)
    more = f" (and {further_pairs} more pairs of cameras)" if further_pairs else ""
    return (
        f'The cameras "{first}" and "{second}" are only {baseline_mm:.2g} mm apart{more}: '
        f"{100 * share:.0f} % of their longest segments coincide as if the scene were infinitely "
        "far away, so this pair gives no depth. Move one of the cameras, or check the rig."
    )


def segments_beyond_fold(counts: Mapping[str, int], radius_px: Mapping[str, float]) -> str:
    """Segments outside the radius within which a lens model is invertible, by view."""
    beyond = ", ".join(
        f'{count} of "{name}" (beyond {radius_px[name]:.0f} px)' for name, count in counts.items()
    )
    return (
        "Segments are excluded because they lie outside the radius within which the lens model is "
        f"one to one: {beyond}. To use them, calibrate with the board nearer to the image corners."
    )


def triples_discarded(count: int) -> str:
    """More likely triples than the memory limit allows."""
    return (
        f"{count} likely triples were discarded to limit the memory, because the images contain "
        "repeated structure. The posteriors of their rivals are lowered by their share. Exclude "
        "the shortest segments, or match parts of the images."
    )


def noise_differs(scale: float) -> str:
    """The estimated noise differs from the stated one. `scale` : estimated over stated sigma."""
    return (
        f"The errors of the segments are {scale:.2g} times the stated sigma, and all covariances "
        f"use this estimate. Pass a sigma_px that is {scale:.2g} times the stated one, so that the "
        "candidate search uses it too."
    )


def cameras_collinear(unlocated: int) -> str:
    """The centres of all cameras lie on one line. `unlocated` : number of excluded tracks."""
    return (
        "The cameras' centres lie on one line, and no pair of views locates segments that are "
        f"parallel to it: {unlocated} tracks are excluded. Move one camera off the line."
    )


def two_views_leave_unlocated(unlocated: int) -> str:
    """Two views do not locate segments along epipolar lines."""
    return (
        "Two views do not locate segments along their epipolar lines: "
        f"{unlocated} tracks are excluded. Add a third camera off the line through the two."
    )


def set_does_not_belong(sure: int, by_chance: float | None, remedy: str) -> str:
    """A set of segments seems not to belong to its rig.

    sure : number of sure lines in three views.
    by_chance : mean number of sure lines of the decoys; None if no decoy was matched.
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
    """Few segments are sure, and their errors are large."""
    return (
        f"Only {sure} of {segments} segments are sure in three views, and their errors are "
        f"{noise_scale:.2g} times the stated sigma: a camera was moved, or an image is cropped or "
        "shifted. Check the rig (check_rig) before you use these matches."
    )


# Mistakes that explain a suspect set.


def most_likely_mistake(description: str, corrected: int, uncorrected: int) -> str:
    """A mistake whose correction gives more sure lines. The counts are of a sample."""
    return (
        f"Most likely {description}: after correction, {corrected} lines of a sample are sure, "
        f"instead of {uncorrected}."
    )


def images_exchanged(views: Iterable[str]) -> str:
    """Images have each other's names."""
    return f"the images of {list_quoted(views)} are exchanged"


def image_turned(view: str, change: str) -> str:
    """An image is mirrored or upside down."""
    return f'the image of "{view}" is {change}'


def image_resized(view: str, size: str) -> str:
    """The segments of one view come from a scaled image. `size` : "half" or "twice"."""
    return f'the segments of "{view}" come from an image of {size} the size of its camera\'s'


def all_images_resized(size: str) -> str:
    """The segments of all views come from scaled images. `size` : "half" or "twice"."""
    return f"the segments come from images of {size} the size of the cameras'"


def image_shifted(view: str, shift_px: Float[ndarray, "2"]) -> str:
    """Text: an image is shifted against its camera in the rig. shift_px : (x, y) shift."""
    return (
        f'the image of "{view}" is shifted by about ({shift_px[0]:.0f}, {shift_px[1]:.0f}) px '
        "against its camera (it is cropped, or its principal point or the camera has moved)"
    )


def list_quoted(names: Iterable[str]) -> str:
    """Names in quotes, joined by "and"."""
    return " and ".join(f'"{name}"' for name in names)


# The cameras of the matched set.


def rig_mirrored(names: Iterable[str], before: int, behind: int) -> str:
    """More lines lie behind all cameras than before them."""
    return (
        f"The rig of {list_names(names)} is mirrored: {behind} lines lie behind its cameras and "
        f"{before} before them. Give the matrices of unmirrored images in a right-handed world."
    )


def camera_mirrored(name: str, reason: str) -> str:
    """A camera is mirrored, or looks away from the scene."""
    return (
        f'Camera "{name}" is mirrored or looks the wrong way ({reason}): give the matrix of the '
        "unmirrored image in a right-handed world, with x to the right and y down."
    )


NEGATIVE_DETERMINANT = "its rotation has determinant -1"
SCENE_BEHIND = "the space that it shares with the other cameras lies behind it"

# Findings on whether matches can be used: explanation, then remedy.


def depth_range_excludes(segments: int) -> str:
    """The depth range excludes more segments than are matched."""
    return (
        f"{segments} segments have no partner within the allowed depths: check depth_range_mm, "
        "which is measured from each camera, in mm."
    )


def calibration_suspect(camera: str, reason: str) -> str:
    """The calibration of a camera was suspect."""
    sentence = f"{reason[:1].upper()}{reason[1:]}"
    return f"the calibration of {camera} was suspect. {sentence}".rstrip()


CALIBRATE_AGAIN = (
    "The 3-D segments inherit this error, and their sigmas do not include it: calibrate again."
)
REMOVE_THE_CAUSE = "No posterior here is above 0.5: remove the cause and match again."
DO_NOT_BELONG = "segments and rig do not belong together."


def only_two_views(tracks: int) -> str:
    """No third view confirms the tracks."""
    return (
        f"of {tracks} tracks. Chance gives lines in two views too, and no third view separates "
        "these from right ones."
    )


ADD_A_CAMERA = "Check that this rig took these images, or add a third camera."


def sure_lines(tracks: int, share: float) -> str:
    """Sure lines among the tracks. `share` : of segments on them in the poorest view, 0 to 1."""
    return (
        f"of {tracks} tracks, which contain {100 * share:.0f} % of the segments of the view with "
        "the fewest matches."
    )


def too_few_sure_lines(required: int) -> str:
    """Fewer sure lines than `required`."""
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
    """Median sigma of the sure lines. `extent` : of nine tenths of their ends, with unit."""
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
    """The line of a free end does not pass through the corner beside it."""
    return (
        f"its line misses the corner beside its end by {distance_mm:.2f} mm: chi-square "
        f"{chi_square:.0f} with 2 degrees of freedom. The end stays free."
    )


def end_leaves_corner(chi_square: float, degrees: int) -> str:
    """A line does not pass through the corner that it was joined to."""
    return (
        f"its line does not pass through the corner at its end: chi-square {chi_square:.0f} with "
        f"{degrees} degrees of freedom. The end was made free."
    )
