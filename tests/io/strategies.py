"""Hypothesis strategies for values that go to files."""

import itertools
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from hypothesis import assume, strategies as st

from tests.geometry.strategies import cameras, real
from trinoc.geometry import Junctions
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import PARAMETER_NAMES, Rig, is_camera_name
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches


@st.composite
def lenses(draw: st.DrawFn) -> Intrinsics:
    """Lenses known in millimetres or in pixels, with and without distortion and skew."""
    size = (draw(st.integers(16, 8000)), draw(st.integers(16, 8000)))
    # The third, p1, does not come without p2.
    some = st.lists(real(-0.3, 0.3), min_size=1, max_size=5).filter(lambda each: len(each) != 3)
    coefficients = st.none() | some
    more = {
        "distortion": draw(coefficients),
        "skew_px": draw(st.sampled_from([0.0, 0.25])),
        "principal_point_px": draw(st.none() | st.tuples(real(0, 100), real(0, 100))),
    }
    if draw(st.booleans()):
        pitch_mm = draw(st.tuples(real(1e-3, 0.05), real(1e-3, 0.05)))
        focal_mm = draw(real(2, 200))
        lens = Intrinsics(
            image_size_px=size, focal_length_mm=focal_mm, pixel_pitch_mm=pitch_mm, **more
        )
        return without_fold(lens)
    focal_px = draw(st.tuples(real(50, 9000), real(50, 9000)))
    pitch_mm = draw(st.none() | st.tuples(real(1e-3, 0.05), real(1e-3, 0.05)))
    lens = Intrinsics(image_size_px=size, focal_length_px=focal_px, pixel_pitch_mm=pitch_mm, **more)
    return without_fold(lens)


def without_fold(lens: Intrinsics) -> Intrinsics:
    """The lens with its distortion reduced until every corner lies inside the fold radius."""
    reach_px = sum(lens.image_size_px) + np.abs(lens.principal_point_px).sum()
    while lens.valid_radius_px < reach_px:
        smaller = lens.lens.coefficients / 8
        lens = eqx.tree_at(lambda intrinsics: intrinsics.lens.coefficients, lens, smaller)
    return lens


def are_apart(cameras: Mapping[str, Camera]) -> bool:
    """Return True if no two cameras have the same position, as readers require."""
    centres = [np.asarray(camera.centre_world_mm) for camera in cameras.values()]
    return all(
        np.linalg.norm(a - b) > 1e-3 * max(np.linalg.norm(a), np.linalg.norm(b))
        for a, b in itertools.combinations(centres, 2)
    )


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    """One to three cameras, with a covariance over four or six parameters each, or none."""
    names = draw(
        st.lists(
            st.text(min_size=1, max_size=8).filter(is_camera_name),
            min_size=1,
            max_size=3,
            unique=True,
        )
    )
    members = {name: draw(cameras(draw(lenses()))) for name in names}
    assume(are_apart(members))
    count = draw(st.sampled_from([0, 4, 6]))
    parameters = [f"{name}.{parameter}" for name in names for parameter in PARAMETER_NAMES[:count]]
    if len(set(parameters)) == 0:
        return Rig(members)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    root = random.normal(scale=1e-3, size=(len(parameters),) * 2)
    return Rig(members, parameters=parameters, covariance=root @ root.T)


@st.composite
def segment_sets(draw: st.DrawFn) -> Segments:
    """Up to five segments, with all fields filled in or as a plain detector leaves them."""
    count = draw(st.integers(0, 5))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = draw(st.none() | st.just((640, 480)))
    plain = Segments.from_endpoints(random.uniform(0, 400, (count, 4)), image_size_px=size)
    if draw(st.booleans()):
        return plain
    root = random.normal(size=(count, 4, 4))
    return Segments(
        plain.endpoints_px,
        root @ root.transpose(0, 2, 1),
        random.integers(-1, 2, count),
        np.where(random.uniform(size=count) < 0.3, np.nan, random.uniform(1, 200, count)),
        random.integers(0, 300, count),
        size,
        draw(st.none() | st.just(random.choice(["", "bent", "neighbour"], count))),
        draw(st.none() | st.just(random.integers(0, 5, count))),
        draw(st.none() | st.just(_junctions(random, count))),
    )


def _junctions(random: np.random.Generator, segments: int) -> Junctions:
    """Junctions of random segments, without any where there are no segments."""
    count, rows = (2, 5) if segments else (0, 0)
    root = random.normal(size=(count, 2, 2))
    return Junctions(
        random.uniform(0, 400, (count, 2)),
        root @ root.transpose(0, 2, 1),
        random.choice(["L", "T", "X", "Y"], count),
        random.integers(0, max(count, 1), rows),
        random.integers(0, max(segments, 1), rows),
        random.integers(-1, 2, rows),
    )


@st.composite
def match_sets(draw: st.DrawFn) -> Matches:
    """Up to five tracks over two to four views."""
    tracks, sides = draw(st.integers(0, 5)), draw(st.integers(2, 4))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    index = random.integers(-1, 9, (tracks, sides))
    index[:, :2] = np.abs(index[:, :2])
    root = random.normal(size=(tracks, 6, 6))
    root_px = random.normal(size=(tracks, sides, 4, 4))
    reasons = st.sampled_from(["matched", "no partner", "é"])
    fragments = random.uniform(0, 500, (tracks, sides, 2, 2))
    fragments[index < 0] = np.nan
    views = tuple(["upper", "left", "right", "fourth"][:sides])
    return Matches(
        views=views,
        index=index,
        fragments_px=fragments,
        lines_mm=random.normal(size=(tracks, 2, 3)),
        covariance_mm2=root @ root.transpose(0, 2, 1),
        stage=np.where((index >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        posterior=random.uniform(size=tracks),
        rival_posterior=random.uniform(size=tracks),
        reasons={
            view: np.array(draw(st.lists(reasons, min_size=9, max_size=12)), str) for view in views
        },
        counts={"candidates": 12, "rejected by neighbours": 3},
        fragments_covariance_px2=draw(st.sampled_from([None, root_px @ root_px.swapaxes(2, 3)])),
        misfit=draw(st.sampled_from([None, random.uniform(size=tracks)])),
        viewpoint_dependent=draw(st.sampled_from([None, random.uniform(size=tracks) < 0.5])),
        noise_scale=draw(st.sampled_from([1.0, 0.37])),
        noise_tail=draw(st.sampled_from([0.0, 0.2])),
        notes=draw(st.sampled_from([(), ("Noise is larger.", "é")])),
    )
