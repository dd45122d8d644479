import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.geometry.strategies import LENS, rigs_of_three
from trinoc.errors import InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.numerics.precision import in_float64


@given(rigs_of_three(), st.permutations(["upper", "left", "right"]))
def test_a_rig_keeps_the_order_of_its_cameras(cameras, names):
    rig = Rig(dict(zip(names, cameras, strict=True)))
    assert list(rig) == names
    leaves, structure = jax.tree.flatten(rig)
    rebuilt = jax.tree.unflatten(structure, leaves)
    assert list(rebuilt) == names
    np.testing.assert_array_equal(rebuilt.matrices_px, rig.matrices_px)
    for name, camera in rig.items():
        assert rig[name] is camera


@given(rigs_of_three())
def test_a_rig_from_matrices_has_these_matrices(cameras):
    matrices = {str(i): camera.matrix_px for i, camera in enumerate(cameras)}
    rig = Rig.from_matrices(matrices, (512, 480))
    np.testing.assert_allclose(
        rig.matrices_px, np.stack(list(matrices.values())), rtol=1e-9, atol=1e-6
    )


def test_some_cameras_keep_their_part_of_the_covariance():
    camera = Camera.from_degrees(LENS, pan_deg=0, tilt_deg=50, swing_deg=0, distance_mm=400)
    # A name may hold a dot, and begin as another one does.
    names = ("cam", "cam.left", "cam.left.2")
    parameters = [f"{name}.{key}" for key in ("pan_deg", "k1") for name in names]
    root = np.random.default_rng(1).normal(size=(6, 6))
    rig = Rig(dict.fromkeys(names, camera), parameters=parameters, covariance=root @ root.T)
    some = rig.take(("cam.left.2", "cam"))
    assert some.names == ("cam", "cam.left.2")
    assert some.parameters == tuple(
        p for p in parameters if not p.startswith("cam.left.") or ".2" in p
    )
    np.testing.assert_array_equal(some.covariance, rig.covariance_of(some.parameters))
    assert jax.tree.all(jax.tree.map(np.array_equal, rig.take(names), rig))
    with pytest.raises(InputError, match='no camera "right"'):
        rig.take(("cam", "right"))


def test_a_sentence_lists_few_names():
    for count, end in ((6, "5"), (7, "5 and 1 more"), (368, "5 and 362 more")):
        assert list_names(map(str, range(count))) == f"0, 1, 2, 3, 4, {end}"


def test_what_a_rig_refuses():
    camera = Camera.from_degrees(LENS, pan_deg=0, tilt_deg=50, swing_deg=0, distance_mm=400)
    rig = Rig({"upper": camera})
    with pytest.raises(InputError, match='no camera "left"'):
        rig["left"]
    with pytest.raises(InputError, match="at least one"):
        Rig({})
    with pytest.raises(InputError, match="2 parameter names"):
        Rig({"upper": camera}, parameters=("a", "b"), covariance=np.zeros((1, 1)))
    with pytest.raises(InputError, match='Camera "left"'):
        Rig.from_matrices({"left": np.zeros((3, 4))}, (512, 480))
    assert np.isnan(rig.sigma("upper.pan_deg"))
    uncertain_rig = Rig(
        {"upper": camera}, parameters=("upper.pan_deg",), covariance=np.array([[0.25]])
    )
    assert uncertain_rig.sigma("upper.pan_deg") == 0.5


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (np.zeros((3, 5)), "shape"),
        ([[0.0, 0, 1, 1], [0, 0, np.nan, 1]], "Segment 1 has a coordinate"),
        ([[0.0, 0, 1, 1], [2, 3, 2, 3]], "Segment 1 has two equal ends"),
    ],
)
def test_segments_that_cannot_be_used_are_refused(rows, message):
    with pytest.raises(InputError, match=message):
        Segments.from_endpoints(np.asarray(rows))


def test_segments_of_either_shape_and_none_at_all():
    rows = np.array([[0.0, 0, 3, 4], [1, 1, 1, 6]])
    segments = Segments.from_endpoints(rows, sigma_px=0.2, sigma_along_px=1.0)
    np.testing.assert_array_equal(
        Segments.from_endpoints(rows.reshape(-1, 2, 2)).endpoints_px, segments.endpoints_px
    )
    np.testing.assert_allclose(segments.length_px, [5, 5])
    assert len(Segments.from_endpoints(np.zeros((0, 4)))) == 0
    across, along = np.array([-0.8, 0.6]), np.array([0.6, 0.8])
    for block in (segments.covariance_px2[0, :2, :2], segments.covariance_px2[0, 2:, 2:]):
        assert across @ block @ across == pytest.approx(0.04)
        assert along @ block @ along == pytest.approx(1.0)


def test_double_precision_ends_with_the_call():
    with jax.enable_x64(False):
        answer = in_float64(lambda x: jax.numpy.asarray(x) / 3)(1.0)
        assert isinstance(answer, np.ndarray)
        assert answer.dtype == np.float64
        assert jax.numpy.asarray(np.float64(1)).dtype == np.float32
