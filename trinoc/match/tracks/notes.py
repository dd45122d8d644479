"""What a user should know of the matches as a whole, in sentences."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.tuning import DEFAULT, NoiseTuning

# Centres lie on a line where they are off it by less than this share of their spread along it.
ON_A_LINE = 0.05


def in_line(centre_mm: Float[np.ndarray, "f v 3"]) -> Bool[np.ndarray, "f"]:
    """Whether the cameras' centres lie on one line, of each frame."""
    centred = centre_mm - centre_mm.mean(axis=1, keepdims=True)
    spread = np.linalg.svd(centred, compute_uv=False)
    return spread[:, 1] < ON_A_LINE * spread[:, 0]


def notes_of(
    views: int,
    cameras_in_line: bool,
    unlocated: int,
    noise_scale: float,
    tuning: NoiseTuning = DEFAULT.noise,
) -> tuple[str, ...]:
    """Sentences on noise that is not as stated, and on cameras in one line."""
    notes = []
    if not 1 / tuning.noted <= noise_scale <= tuning.noted:
        word = "larger" if noise_scale > 1 else "smaller"
        notes.append(
            f"The segments' errors are {word} than stated, {noise_scale:.2g} times: covariances "
            "are of the errors found; give a sigma_px that is as much "
            f"{word} to have candidates judged by it too."
        )
    if views > 2:
        if cameras_in_line:
            notes.append(
                "The cameras' centres lie on one line: segments along it are along the epipolar "
                f"lines of all views, and no pair of views locates them ({unlocated} tracks left "
                "out); move one camera off the line to see them."
            )
    elif unlocated:
        notes.append(
            f"Two views do not locate segments along their epipolar lines ({unlocated} tracks "
            "left out): a third view off the line of the two would."
        )
    return tuple(notes)
