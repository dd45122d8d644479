"""Hypothesis strategies for what files of other tools can hold, and projections to compare."""

import jax
import numpy as np
from hypothesis import assume, strategies as st

from tests.geometry.strategies import cameras, real
from tests.io.strategies import are_apart, without_fold
from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig

NAMES = st.from_regex(r"\A[a-v][a-z0-9_]{0,7}\Z")
# The coefficients in our order, each small enough that the lens stays one to one.
REACH = {"k1": 0.3, "k2": 0.1, "p1": 0.01, "p2": 0.01, "k3": 0.05}
CORNERS = np.array([[x, y, z] for x in (-60, 60) for y in (-60, 60) for z in (0, 60)], dtype=float)


@st.composite
def lenses(draw: st.DrawFn, coefficients: int = 5, skew: bool = False) -> Intrinsics:
    """Lenses with up to so many coefficients, or ideal."""
    reaches = list(REACH.values())[:coefficients]
    distortion = st.none() | st.tuples(*(real(-reach, reach) for reach in reaches))
    return without_fold(
        Intrinsics(
            image_size_px=(draw(st.integers(200, 4000)), draw(st.integers(200, 4000))),
            focal_length_px=draw(st.tuples(real(300, 3000), real(300, 3000))),
            principal_point_px=draw(st.tuples(real(50, 2000), real(50, 2000))),
            skew_px=draw(st.sampled_from([0.0, 0.75])) if skew else 0.0,
            distortion=draw(distortion),
        )
    )


@st.composite
def rigs(
    draw: st.DrawFn,
    coefficients: int = 5,
    skew: bool = False,
    min_cameras: int = 1,
    max_cameras: int = 4,
) -> Rig:
    """Rigs of cameras around the sheet."""
    names = draw(st.lists(NAMES, min_size=min_cameras, max_size=max_cameras, unique=True))
    members = {name: draw(cameras(draw(lenses(coefficients, skew)))) for name in names}
    assume(are_apart(members))
    return Rig(members)


def pixels(camera: Camera, points: np.ndarray = CORNERS) -> np.ndarray:
    """Pixel coordinates of the images of points, (n, 2)."""
    return np.asarray(jax.vmap(project, (None, 0))(camera, points))


def in_frame_of(camera: Camera, points: np.ndarray = CORNERS) -> np.ndarray:
    """Points of the world in the frame of a camera."""
    pose = np.asarray(camera.cam_from_world)
    return points @ pose[:, :3].T + pose[:, 3]
