"""Evidence of segments as images of one line, by plain integration over all lines in space."""

import itertools

import numpy as np

from tests.match.scene import image_px

NODES = 5


def log_evidence(
    matrices_px: np.ndarray,
    ends_px: np.ndarray,
    across_px2: np.ndarray,
    near_mm: np.ndarray,
) -> float:
    """Log of the density of all ends, integrated over all lines: position across and direction.

    A line has four parameters: its intersections with two planes across `near_mm` (2, 3), a line
    near the peak. Their measure over the squared distance of the planes is that of position and
    direction. `ends_px` (v, 2, 2) deviate from the image of the line by N(0, across_px2).
    Gauss-Hermite quadrature about the peak, on the exact projection.
    """
    along = near_mm[1] - near_mm[0]
    basis = np.linalg.svd(along[None])[2][1:]
    precision = np.linalg.inv(across_px2)
    views = range(len(matrices_px))

    def deviations(x: np.ndarray) -> np.ndarray:
        """Deviations of the ends from the images of lines x (n, 2, 2), px, (n, v, 2)."""
        image = np.stack([image_px(m, near_mm + x @ basis) for m in matrices_px], axis=1)
        direction = image[:, :, 1] - image[:, :, 0]
        normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return ((ends_px - image[:, :, :1]) * normal[:, :, None]).sum(-1)

    peak, steps = np.zeros((1, 2, 2)), 1e-4 * np.eye(4).reshape(4, 2, 2)
    for _ in range(4):
        peak_deviations = deviations(peak)[0]
        jacobian = (deviations(peak + steps) - deviations(peak - steps)) / 2e-4
        hessian = sum(jacobian[:, v] @ precision[v] @ jacobian[:, v].T for v in views)
        gradient = sum(jacobian[:, v] @ precision[v] @ peak_deviations[v] for v in views)
        peak = peak - np.linalg.solve(hessian, gradient).reshape(1, 2, 2)
    # Standard normal coordinates z: x = peak + root z.
    root = np.linalg.inv(np.linalg.cholesky(hessian)).T
    node, weight = np.polynomial.hermite_e.hermegauss(NODES)
    z = np.array(list(itertools.product(node, repeat=4)))
    w = np.prod(list(itertools.product(weight, repeat=4)), axis=1)
    error = deviations(peak + (z @ root.T).reshape(-1, 2, 2))
    square = np.einsum("nvi,vij,nvj->n", error, precision, error)
    log_scale = 0.5 * np.linalg.slogdet(precision)[1].sum() - len(precision) * np.log(2 * np.pi)
    mean = w @ np.exp(-0.5 * (square - (z**2).sum(1)))
    return float(
        np.log(mean) + log_scale + np.linalg.slogdet(root)[1] - 2 * np.log(np.sum(along**2)) / 2
    )
