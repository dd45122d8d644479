"""Matches as columns: one row for each track, all that is known of it."""

import numpy as np

from trinoc.match import Matches

AXES = ("x", "y", "z")
# The upper triangle of a covariance of the six coordinates, row by row.
UPPER = tuple(zip(*(axis.tolist() for axis in np.triu_indices(6)), strict=True))
COORDINATES = tuple(f"{axis}{end}" for end in (1, 2) for axis in AXES)


def lines_table(matches: Matches, unit_mm: float) -> dict[str, np.ndarray]:
    """Columns by name; lengths in units of `unit_mm`, named _mm where that is a millimetre.

    The ends, the length, the stage, the posteriors, then for each view the segment (-1 where not
    seen) and the fragment in px, then the upper triangle of the covariance of the six coordinates.
    """
    unit = "_mm" if unit_mm == 1 else ""
    ends = matches.lines_mm.reshape(-1, 6) / unit_mm
    columns: dict[str, np.ndarray] = {}
    columns |= {f"{name}{unit}": ends[:, k] for k, name in enumerate(COORDINATES)}
    length = np.linalg.norm(matches.lines_mm[:, 1] - matches.lines_mm[:, 0], axis=1)
    columns[f"length{unit}"] = length / unit_mm
    columns["stage"] = np.asarray(matches.stage, dtype=np.str_)
    columns["posterior"] = matches.posterior
    columns["rival_posterior"] = matches.rival_posterior
    if matches.misfit is not None:
        columns["misfit"] = matches.misfit
    if matches.viewpoint_dependent is not None:
        columns["viewpoint_dependent"] = matches.viewpoint_dependent
    if matches.silhouette is not None:
        columns["silhouette"] = matches.silhouette
    if matches.shadow is not None:
        columns["shadow"] = matches.shadow
    for number, view in enumerate(matches.views):
        columns[f"{view}_segment"] = matches.index[:, number]
        fragments = matches.fragments_px[:, number].reshape(-1, 4)
        for k, name in enumerate(("u1", "v1", "u2", "v2")):
            columns[f"{view}_{name}_px"] = fragments[:, k]
    covariance = matches.covariance_mm2 / unit_mm**2
    for row, column in UPPER:
        name = f"cov_{COORDINATES[row]}_{COORDINATES[column]}{unit and '_mm2'}"
        columns[name] = covariance[:, row, column]
    return columns
