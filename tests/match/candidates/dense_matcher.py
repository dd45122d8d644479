"""A simple matcher of three views: every pair against every third segment, in NumPy.

Each segment of one view with each of another that shares epipolar planes predicts two points in
the third view; every segment there within three sigma of both, and overlapping, is a triple;
the nearest are taken first. It uses no likelihoods, no neighbours and no pairs.
"""

import numpy as np

BLOCK = 256


def match_densely(
    ends_px: list[np.ndarray], matrices_px: np.ndarray, *, sigma_px: float = 0.5
) -> np.ndarray:
    """Segment numbers in each view of the accepted triples, (t, 3)."""
    triples_by_first, score = [], []
    fundamental = _fundamental(matrices_px[0], matrices_px[1])
    lines = [_lines(ends) for ends in ends_px]
    for i in range(len(ends_px[0])):
        # Points where the epipolar lines of both ends cut every segment of the second view.
        across = np.cross(lines[1][:, None], (fundamental @ _homogeneous(ends_px[0][i]).T).T[None])
        partner = across[..., :2] / across[..., 2:]
        along = ends_px[1][:, 1] - ends_px[1][:, 0]
        share = ((partner - ends_px[1][:, :1]) * along[:, None]).sum(-1)
        share /= (along**2).sum(-1)[:, None]
        overlapping = np.flatnonzero((share.max(1) > 0.15) & (share.min(1) < 0.85))
        if len(overlapping) == 0:
            continue
        points = _triangulated(matrices_px, ends_px[0][i], partner[overlapping])
        image = points @ matrices_px[2][:, :3].T + matrices_px[2][:, 3]
        image = image[..., :2] / image[..., 2:]
        for block in range(0, len(overlapping), BLOCK):
            part = image[block : block + BLOCK]
            distance = np.abs(
                np.einsum("pex,kx->pke", part, lines[2][:, :2]) + lines[2][None, :, 2:]
            ).max(-1)
            step = part[:, 1] - part[:, 0]
            ends = ends_px[2][None] - part[:, None, None, 0]
            end_share = (ends * step[:, None, None]).sum(-1) / (step**2).sum(-1)[:, None, None]
            overlaps = (end_share.max(-1) > 0.15) & (end_share.min(-1) < 0.85)
            j, k = np.nonzero((distance < 3 * sigma_px) & overlaps)
            triples_by_first.append(
                np.stack([np.full(len(j), i), overlapping[block + j], k], axis=1)
            )
            score.append(distance[j, k])
    triples = np.concatenate(triples_by_first) if triples_by_first else np.zeros((0, 3), dtype=int)
    used = [np.zeros(len(ends), dtype=bool) for ends in ends_px]
    taken = []
    for row in triples[np.argsort(np.concatenate(score))] if triples_by_first else []:
        if not any(used[v][s] for v, s in enumerate(row)):
            taken.append(row)
            for v, s in enumerate(row):
                used[v][s] = True
    return np.array(taken).reshape(-1, 3)


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)


def _lines(ends_px: np.ndarray) -> np.ndarray:
    line = np.cross(_homogeneous(ends_px[:, 0]), _homogeneous(ends_px[:, 1]))
    return line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)


def _fundamental(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    centre = np.append(-np.linalg.solve(first[:, :3], first[:, 3]), 1.0)
    x, y, z = second @ centre
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return skew @ second[:, :3] @ np.linalg.inv(first[:, :3])


def _triangulated(matrices: np.ndarray, ends: np.ndarray, partner: np.ndarray) -> np.ndarray:
    """Points triangulated from both ends and each partner by linear least squares, (p, 2, 3)."""
    rows = []
    for matrix, uv in ((matrices[0], np.broadcast_to(ends, partner.shape)), (matrices[1], partner)):
        rows += [uv[..., :1] * matrix[2] - matrix[0], uv[..., 1:] * matrix[2] - matrix[1]]
    a = np.stack(rows, axis=-2)
    return np.linalg.solve(
        np.einsum("...ri,...rj->...ij", a[..., :3], a[..., :3]),
        -np.einsum("...ri,...r->...i", a[..., :3], a[..., 3])[..., None],
    )[..., 0]
