"""Status of the fit of a camera."""

import enum


class Status(enum.Enum):
    """Status of the fit of one camera. The value of each member is the sentence for the user."""

    CONVERGED = "The fit converged and its parameters are determined."
    SUSPECT = "The fit converged, but its residuals contradict the model: see the notes."
    NOT_CONVERGED = "The fit did not converge: its parameters must not be used."
    NOT_DETECTED = "The sheet was not found in the image."
    AMBIGUOUS = "The sheet looks the same after a turn: give its orientation."
    RANK_DEFICIENT = "The observations do not determine all parameters: see the gauge."
