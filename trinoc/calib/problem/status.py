"""How the fit of a camera ended."""

import enum


class Status(enum.Enum):
    """How the fit of one camera ended; the value is the sentence shown to people."""

    CONVERGED = "The fit converged and its parameters are determined."
    SUSPECT = "The fit converged, but its residuals are not those of this model: see the notes."
    NOT_CONVERGED = "The fit did not converge: its parameters are not a result."
    NOT_DETECTED = "The sheet was not found in the picture."
    AMBIGUOUS = "The sheet looks the same turned, and nothing says which way round it lies."
    RANK_DEFICIENT = "The observations leave some parameters free: see the named gauge."
