"""The steps after matching, by their names, in the order in which they are taken.

Python (`improve`) and the command have this one vocabulary. A step that finds features adds them to
what is found, by their kind.
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
from trinoc.match.pixels.measure import measure_lines
from trinoc.match.rims.explained_tracks import add_rims
from trinoc.match.rims.rim_search import find_rims
from trinoc.match.step_names import StepName
from trinoc.match.tracks.matches import Matches
from trinoc.match.wire_frame.build import wireframe


class StepResult(NamedTuple):
    """What matching and the steps after it found.

    Fields
    ------
    matches : the tracks, with what the steps say of them.
    segments : of each view, those that the matches number.
    features : those that steps found, by their kind.
    """

    matches: Matches
    segments: Mapping[str, Segments]
    features: Mapping[str, Feature] = {}

    def with_features(self, own: Feature) -> "StepResult":
        """The same and features of another kind."""
        return self._replace(features={**self.features, own.KIND: own})


class StepInput(NamedTuple):
    """What steps work with: see `improve`."""

    rig: Rig
    pictures: Mapping[str, Shaped[np.ndarray, "..."]]
    arcs: Callable[[], Mapping[str, Segments]] | None
    depth_range_mm: tuple[float, float] | None
    response: ResponseLike


class Step(NamedTuple):
    """What a step does, in words; what it needs beside segments; and the step itself."""

    said: str
    needs: str
    take: Callable[[StepResult, StepInput], StepResult]


def _measure(found: StepResult, given: StepInput) -> StepResult:
    measured = measure_lines(
        found.matches, found.segments, given.rig, given.pictures, response=given.response
    )
    return found._replace(matches=measured)


def _rims(found: StepResult, given: StepInput) -> StepResult:
    chords = given.arcs() if given.arcs is not None else {}
    among = match_segments(chords, given.rig, depth_range_mm=given.depth_range_mm)
    rims = find_rims(among, chords, given.rig)
    joined = add_rims(found.matches, found.segments, rims, chords, given.rig)
    return found._replace(matches=joined.matches, segments=joined.segments).with_features(rims)


def _wireframe(found: StepResult, given: StepInput) -> StepResult:
    return found.with_features(wireframe(found.matches, given.rig))


STEPS: dict[StepName, Step] = {
    "pixels": Step("measuring the lines in the pictures", "pictures", _measure),
    "rims": Step("looking for rims", "arcs", _rims),
    "wireframe": Step("putting corners, edges and faces together", "", _wireframe),
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
    """Take some of the steps after matching, in their own order.

    Parameters
    ----------
    matches, segments : of `match_segments`, and the segments that were matched.
    rig : the cameras.
    steps : of STEPS: "pixels" (`measure_lines`), "rims" (`find_rims`, `add_rims`), "wireframe"
        (`wireframe`).
    pictures : of each view; "pixels" needs them.
    arcs : gives the segments with the chords of arcs (`find_segments(arcs=True)`), which "rims"
        needs.
    depth_range_mm : as the segments were matched.
    response : how the cameras make grey levels of light, as `find_segments` has it.
    begin : is called before each step.

    Raises InputError for a name that no step has, and for steps that lack what they need.
    """
    unknown = [step for step in steps if step not in STEPS]
    if unknown:
        raise InputError(f'There is no step "{unknown[0]}": choose of {", ".join(STEPS)}.')
    given = StepInput(rig, pictures or {}, arcs, depth_range_mm, response)
    found = StepResult(matches, segments)
    chosen = {name: step for name, step in STEPS.items() if name in steps}
    for name, step in chosen.items():
        if step.needs == "pictures" and not set(matches.views) <= set(given.pictures):
            raise InputError(f'The step "{name}" needs the picture of each view: give `pictures`.')
        if step.needs == "arcs" and arcs is None:
            raise InputError(f'The step "{name}" needs segments with arcs: give `arcs`.')
    for step in chosen.values():
        begin(step)
        found = step.take(found, given)
    return found
