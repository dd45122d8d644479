"""Steps after matching, by name, in the sequence in which they run.

Python (`improve`) and the command use the same names. A step that detects features in space adds
the features to the result under the name of their kind. A step imports its code when it runs,
because most matchings use no step.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from trinoc.errors import InputError
from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.image.response import ResponseLike
from trinoc.match.matcher import match_segments
from trinoc.match.step_names import StepName
from trinoc.match.tracks.matches import Matches


class StepResult(NamedTuple):
    """Result of matching and of the steps after it.

    Attributes
    ----------
    matches : Matches
        The tracks, with the marks that the steps set on them.
    segments : mapping
        Segments of each view, numbered as in the matches.
    features : mapping
        Detected features in space, by the name of their kind.
    """

    matches: Matches
    segments: Mapping[str, Segments]
    features: Mapping[str, Feature] = {}

    def with_features(self, feature: Feature) -> "StepResult":
        """Return the result with one more kind of features."""
        return self._replace(features={**self.features, feature.KIND: feature})


class StepInput(NamedTuple):
    """Inputs of all steps: arguments of `improve`, where `images` is called `pictures`."""

    rig: Rig
    images: Mapping[str, Shaped[np.ndarray, "..."]]
    arcs: Callable[[], Mapping[str, Segments]] | None
    depth_range_mm: tuple[float, float] | None
    response: ResponseLike


class Step(NamedTuple):
    """One step after matching.

    Attributes
    ----------
    description : str
        Text for the log.
    requirement : str
        Name of the argument of `improve` that the step needs, or "".
    run : callable
        Function that runs the step.
    """

    description: str
    requirement: str
    run: Callable[[StepResult, StepInput], StepResult]


def _measure(result: StepResult, inputs: StepInput) -> StepResult:
    from trinoc.match.pixels.measure import measure_lines

    measured = measure_lines(
        result.matches, result.segments, inputs.rig, inputs.images, response=inputs.response
    )
    return result._replace(matches=measured)


def _rims(result: StepResult, inputs: StepInput) -> StepResult:
    from trinoc.match.rims.explained_tracks import add_rims
    from trinoc.match.rims.rim_search import find_rims

    chords = inputs.arcs() if inputs.arcs is not None else {}
    chord_matches = match_segments(chords, inputs.rig, depth_range_mm=inputs.depth_range_mm)
    rims = find_rims(chord_matches, chords, inputs.rig)
    extended = add_rims(result.matches, result.segments, rims, chords, inputs.rig)
    return result._replace(matches=extended.matches, segments=extended.segments).with_features(rims)


def _wireframe(result: StepResult, inputs: StepInput) -> StepResult:
    from trinoc.match.wire_frame.build import wireframe

    return result.with_features(wireframe(result.matches, inputs.rig))


STEPS: dict[StepName, Step] = {
    "pixels": Step("measuring the lines in the images", "pictures", _measure),
    "rims": Step("detecting rims", "arcs", _rims),
    "wireframe": Step("building the wire frame of corners, edges and faces", "", _wireframe),
}


def improve(
    matches: Matches,
    segments: Mapping[str, Segments],
    rig: Rig,
    steps: Sequence[StepName],
    *,
    pictures: Mapping[str, Shaped[np.ndarray, "..."]] | None = None,
    arcs: Callable[[], Mapping[str, Segments]] | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    response: ResponseLike = "linear",
    begin: Callable[[Step], None] = lambda step: None,
) -> StepResult:
    """Run the given steps after matching, always in the sequence of `STEPS`.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`.
    segments : mapping
        Segments of each view that were matched.
    rig : Rig
        The cameras.
    steps : sequence of str
        "pixels" (`measure_lines`), "rims" (`find_rims`, `add_rims`) or "wireframe" (`wireframe`).
    pictures : mapping, optional
        Image of each view. Required for "pixels".
    arcs : callable, optional
        Function that returns the segments with the chords of arcs (`find_segments(arcs=True)`).
        Required for "rims".
    depth_range_mm : (float, float), optional
        Depth range that was used for matching.
    response : str or float
        Response of the cameras to light, as in `find_segments`.
    begin : callable
        Function that is called before each step.

    Returns
    -------
    StepResult
        Matches, segments and features after all steps.

    Raises
    ------
    InputError
        If a step is unknown or its required argument is missing.
    """
    unknown = [step for step in steps if step not in STEPS]
    if unknown:
        raise InputError(f'There is no step "{unknown[0]}": choose from {", ".join(STEPS)}.')
    inputs = StepInput(rig, pictures or {}, arcs, depth_range_mm, response)
    result = StepResult(matches, segments)
    selected = {name: step for name, step in STEPS.items() if name in steps}
    for name, step in selected.items():
        if step.requirement == "pictures" and not set(matches.views) <= set(inputs.images):
            raise InputError(f'The step "{name}" needs the image of each view: pass `pictures`.')
        if step.requirement == "arcs" and arcs is None:
            raise InputError(f'The step "{name}" needs segments with arcs: pass `arcs`.')
    for step in selected.values():
        begin(step)
        result = step.run(result, inputs)
    return result
