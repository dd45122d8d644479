"""Steps after matching, by name, in the order in which they run.

Python (`improve`) and the command use the same names. A step that detects features in space adds
them to the result under their kind. A step imports its work itself, because most matchings take
none.
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

    Fields
    ------
    matches : the tracks, with the marks that the steps set on them.
    segments : the segments of each view, in the numbering of the matches.
    features : detected features in space, by kind.
    """

    matches: Matches
    segments: Mapping[str, Segments]
    features: Mapping[str, Feature] = {}

    def with_features(self, feature: Feature) -> "StepResult":
        """Return the same result with features of one more kind."""
        return self._replace(features={**self.features, feature.KIND: feature})


class StepInput(NamedTuple):
    """Inputs that the steps share; see `improve`."""

    rig: Rig
    images: Mapping[str, Shaped[np.ndarray, "..."]]
    arcs: Callable[[], Mapping[str, Segments]] | None
    depth_range_mm: tuple[float, float] | None
    response: ResponseLike


class Step(NamedTuple):
    """One step: description for the log, required input beside segments, and the function that
    runs it.
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
    """Run some of the steps after matching, in their fixed order.

    Parameters
    ----------
    matches : result of `match_segments`.
    segments : the matched segments, by view.
    rig : the cameras.
    steps : names from STEPS: "pixels" (`measure_lines`), "rims" (`find_rims`, `add_rims`),
        "wireframe" (`wireframe`).
    pictures : image of each view. Required by "pixels".
    arcs : function that returns the segments with the chords of arcs (`find_segments(arcs=True)`).
        Required by "rims".
    depth_range_mm : depth range that was used for matching.
    response : response of the cameras to light, as in `find_segments`.
    begin : function that is called before each step.

    Returns
    -------
    StepResult

    Raises
    ------
    InputError : unknown step name, or a step without its required input.
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
