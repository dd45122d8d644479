"""Two rims, with every field of `Rims`."""

import numpy as np

from tests.io.formats.bench import bench_matches
from trinoc.match import Rims


def made_rims() -> Rims:
    """One flat rim and one tilted rim, with tracks of which one was dropped."""
    matches = bench_matches()
    root = np.random.default_rng(5).normal(size=(2, 7, 7))
    return Rims(
        views=matches.views,
        centre_mm=np.array([[0.0, 0.0, 30.0], [40.0, -10.0, 5.0]]),
        normal=np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]),
        radius_mm=np.array([15.0, 6.5]),
        covariance_mm2=root @ root.mT,
        covered=np.array([0.9, 0.3]),
        rim=np.array([0, 0, 0, 1, 1]),
        view=np.array([0, 1, 1, 0, 1]),
        segment=np.array([3, 4, 0, 9, 2]),
        matches=matches,
        kept=np.array([0, 2]),
        counts={"rims": 2, "pieces of rims": len(matches) - 2},
    )
