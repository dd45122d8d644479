"""What the first call would compile, compiled before: for services, whose first user waits."""

import numpy as np
from jaxtyping import Float

from trinoc.geometry.rig import Rig
from trinoc.match.batch import match_many
from trinoc.match.matcher import compile_together, match_frames
from trinoc.match.observations.match_input import prepare_frame, stack_frames
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tables import with_field

# numerical: lengths of made segments, as shares of the picture's longer side.
SHORTEST, LONGEST = 0.01, 0.05


@in_float64
def warm_up(
    rig: Rig, segments_per_view: int, *, frames: int = 1, tuning: MatchTuning = DEFAULT
) -> None:
    """Compile what `match_segments` of all views of `rig` runs, for about as many segments.

    With `frames`, what `match_many` runs for so many frames of that size. Kernels are compiled for
    numbers of segments rounded up to powers of two, so that one call serves all numbers between
    two of these. Pictures with more or fewer rivals than those made here, random segments, may
    compile one small kernel more. Takes as long as a first call; what `enable_compile_cache`
    keeps is not compiled again.

    Raises ValueError where `segments_per_view` or `frames` is below 1.
    """
    if segments_per_view < 1 or frames < 1:
        raise ValueError(
            f"Warming up takes at least one segment and one frame, but got {segments_per_view} "
            f"and {frames}: give the numbers that are usual."
        )
    generator = np.random.default_rng(0)
    pictures = [
        {
            name: _random_segments(generator, segments_per_view, camera.image_size_px)
            for name, camera in rig.items()
        }
        for _ in range(frames)
    ]
    if frames > 1:
        match_many(pictures, rig, tuning=tuning)
    else:
        # Random segments make few lines, which would not be learned from in large pictures.
        for name, value in {"fewest": 0, "sure": 0.0}.items():
            tuning = with_field(tuning, f"scouting.{name}", value)
        frame = prepare_frame(pictures[0], rig, None, tuning.sides)
        compile_together(stack_frames([frame]), tuning, for_many=True)
        match_frames([frame], [rig.names], None, tuning)


def _random_segments(
    generator: np.random.Generator, count: int, size_px: tuple[int, int]
) -> Float[np.ndarray, "n 4"]:
    longer = max(size_px)
    middle = generator.uniform(0, size_px, (count, 2))
    angle, length = (
        generator.uniform(0, np.pi, count),
        generator.uniform(SHORTEST * longer, LONGEST * longer, count),
    )
    half = length[:, None] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([middle - half, middle + half], axis=1)
