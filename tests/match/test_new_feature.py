"""A new kind of feature (one class, one line in the registry) reaches files, exports and cards."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
import pytest
from jaxtyping import Float

import trinoc
from trinoc.errors import InputError
from trinoc.geometry.features import Feature, Wires, wires_of_lines
from trinoc.io import FORMATS
from trinoc.match.features import FEATURES
from trinoc.numerics.tables import COVARIANCE, IN_SCENE, PROBABILITY, Column
from trinoc.report.notebook.cards import make_card
from trinoc.report.notebook.tables import list_columns


class Ellipses(Feature):
    """Ellipses, each by its centre and two half axes."""

    KIND: ClassVar[str] = "ellipses"
    IN_WORDS: ClassVar[str] = "ellipses"
    SIDES: ClassVar[Mapping[str, str]] = {"c": "ellipses"}

    centre_mm: Annotated[Float[np.ndarray, "c 3"], Column(IN_SCENE, parts=("x_mm", "y_mm", "z_mm"))]
    half_axes_mm: Annotated[Float[np.ndarray, "c 2 3"], Column(IN_SCENE)]
    covariance_mm2: Annotated[Float[np.ndarray, "c 9 9"], Column(COVARIANCE)]
    posterior: Annotated[Float[np.ndarray, "c"], Column(PROBABILITY)]

    def wires(self) -> Wires:
        """Wires of the ellipses, each a closed line of 24 pieces."""
        angle = np.linspace(0, 2 * np.pi, 25)
        offset = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ self.half_axes_mm
        return wires_of_lines([[line] for line in self.centre_mm[:, None] + offset])


@pytest.fixture
def ellipses():
    FEATURES.append(Ellipses)
    axes = np.array([[[20.0, 0, 0], [0, 10, 0]], [[0, 5.0, 0], [0, 0, 5]]])
    centres = np.array([[0.0, 0, 5], [40, 10, 20]])
    yield Ellipses(centres, axes, np.tile(np.eye(9), (2, 1, 1)), np.array([0.9, 0.8]))
    FEATURES.remove(Ellipses)


def test_it_is_saved_and_loaded(ellipses, tmp_path) -> None:
    trinoc.save(ellipses, tmp_path / "ellipses.npz")
    back = trinoc.load(tmp_path / "ellipses.npz")
    assert isinstance(back, Ellipses)
    for name, column in ellipses.rows().items():
        np.testing.assert_array_equal(getattr(back, name), column)
    with pytest.raises(InputError, match=r"ellipses are written as \.npz"):
        trinoc.save(ellipses, tmp_path / "ellipses.json")


def test_what_no_ellipse_has_is_refused(ellipses, tmp_path) -> None:
    trinoc.save(ellipses, tmp_path / "ellipses.npz")
    with np.load(tmp_path / "ellipses.npz") as content:
        arrays = dict(content)
    np.savez(tmp_path / "wrong.npz", **{**arrays, "posterior": np.array([0.5, 1.5])})
    with pytest.raises(InputError, match='"posterior" of row 1 is no probability'):
        trinoc.load(tmp_path / "wrong.npz")
    np.savez(tmp_path / "wrong.npz", **{**arrays, "posterior": np.ones(3)})
    with pytest.raises(InputError, match=r"2 ellipses need \(2\)"):
        trinoc.load(tmp_path / "wrong.npz")


@pytest.mark.parametrize("name", ["obj", "ply", "dxf", "gltf"])
def test_it_is_exported_as_lines(ellipses, tmp_path, name) -> None:
    path = tmp_path / f"ellipses{FORMATS[name].endings[0]}"
    FORMATS[name].save(ellipses, path)
    assert path.stat().st_size > 48 * 10


def test_it_shows_itself(ellipses) -> None:
    assert "2 ellipses" in make_card(ellipses)
    assert list(list_columns(ellipses))[:3] == ["x_mm", "y_mm", "z_mm"]
    drawn = [line for _, line in ellipses.wires().lines()]
    assert [line.shape for line in drawn] == [(25, 3), (25, 3)]
