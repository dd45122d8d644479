"""Matched lines measured in the grey levels of all their views."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Shaped

from trinoc.geometry import Rig, Segments
from trinoc.image import Light, ResponseLike
from trinoc.match.observations import as_segments, check_pictures
from trinoc.match.pixels.answer import measured
from trinoc.match.pixels.images import line_images
from trinoc.match.pixels.tuning import DEFAULT, PixelTuning
from trinoc.match.pixels.view_fit import fit_view
from trinoc.match.tracks import Matches
from trinoc.numerics import ArrayLike, in_float64


@in_float64
def measure_lines(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    pictures: Mapping[str, Shaped[np.ndarray, "..."]],
    *,
    response: ResponseLike = "linear",
    tuning: PixelTuning = DEFAULT,
) -> Matches:
    """Fit every matched line to the grey levels of all its views.

    Beside the image of a line, each view's pixels are a step between two levels, blurred by a
    Gaussian. Levels and blur are fitted in every view and eliminated. What remains says where the
    line's image is, and the four parameters of the line in space follow from all views together.
    A view that shows no clean step there keeps its segment's place. A Hausman test compares both
    answers.

    Parameters
    ----------
    matches : of `match_segments`, or of `guide_matches`.
    segments : those that the matches number.
    rig : the cameras that they were matched with.
    pictures : for each view of `matches` its picture, as `find_segments` takes it.
    response : how the cameras make grey levels of light, as in `find_segments`.
    tuning : every tuned constant.

    Returns
    -------
    The same tracks. `measure` says which view rests on its pixels, or why it does not. Lines,
    fragments, their covariances and `misfit` follow; ends keep their places along the lines.

    Raises
    ------
    InputError : views without a picture or segments, pictures of another size than their camera's.

    Source of the test: J. A. Hausman, "Specification tests in econometrics", 1978,
    doi:10.2307/1913827.
    """
    check_pictures("Measuring lines", matches.views, segments, rig, pictures)
    images, views = [], []
    for view, name in enumerate(matches.views):
        own = as_segments(segments[name])
        lens = rig[name].intrinsics
        seen = line_images(matches, view, own, np.asarray(rig[name].matrix_px), lens)
        light = Light.from_picture(pictures[name], response)
        every = np.asarray(own.endpoints_px, dtype=np.float64)
        images.append(seen)
        views.append(fit_view(light, every, lens, seen, tuning))
    return measured(matches, rig, images, views, tuning)
