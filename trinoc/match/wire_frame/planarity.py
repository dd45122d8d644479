"""Vertices held to the planes of their faces: least squares under that constraint."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.wire_frame.adjustment import Adjusted
from trinoc.match.wire_frame.faces import Face, plane_through

# Planes turn a little as their vertices move.
STEPS = 3


def flattened(answer: Adjusted, faces: list[Face]) -> Adjusted:
    """The likeliest vertices of which those of each face lie in a plane, and their covariance."""
    points, covariance = answer.points_mm.copy(), list(answer.covariance_mm2)
    for part in sorted({int(answer.part[face.loop[0]]) for face in faces}):
        members = np.flatnonzero(answer.part == part)
        loops = [face.loop for face in faces if answer.part[face.loop[0]] == part]
        spread, start = answer.covariance_mm2[part], answer.points_mm[members].reshape(-1)
        place = start
        for _ in range(STEPS):
            points[members] = place.reshape(-1, 3)
            here = answer._replace(points_mm=points)
            rows = np.concatenate([_rows(here, loop, members) for loop in loops])
            if len(rows) == 0:
                break
            gain = spread @ rows.T @ np.linalg.pinv(rows @ spread @ rows.T, hermitian=True)
            place = start - gain @ (rows @ start)
            covariance[part] = spread - gain @ rows @ spread
        points[members] = place.reshape(-1, 3)
    return answer._replace(points_mm=points, covariance_mm2=tuple(covariance))


def _rows(
    answer: Adjusted, loop: Int[np.ndarray, "k"], members: Int[np.ndarray, "m"]
) -> Float[np.ndarray, "c d"]:
    """k - 3 numbers that vanish where k vertices lie in one plane, by all vertices of the part."""
    points, normal = answer.points_mm[loop], plane_through(answer, loop, flattened=True).plane[:3]
    axes = np.linalg.svd(normal[None])[2][1:]
    inside = (points - points.mean(axis=0)) @ axes.T
    free = np.column_stack([inside, np.ones(len(loop))])
    null = np.linalg.svd(free.T)[2][3:]
    rows = np.zeros((len(null), len(members), 3))
    rows[:, np.searchsorted(members, loop)] = null[:, :, None] * normal
    return rows.reshape(len(null), 3 * len(members))
