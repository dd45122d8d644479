"""The scene to turn: served to this machine alone, and gone when it is stopped."""

import contextlib
from collections.abc import Iterator

import numpy as np
import pytest

from tests.serving.asking import ask
from trinoc.errors import InputError
from trinoc.report.space_content import error_ellipsoids, visible_factor
from trinoc.report.space_part import space_figure
from trinoc.serving import space
from trinoc.serving.space import serve_space
from trinoc.synth import table1_rig


def some_lines(tracks: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Ends and covariances, one of which is not known."""
    rng = np.random.default_rng(5)
    factors = rng.normal(size=(tracks, 6, 6))
    covariance = factors @ factors.swapaxes(1, 2)
    covariance[1, 3:, 3:] = np.nan
    return rng.normal(size=(tracks, 2, 3)), covariance


def test_ellipsoids_have_the_covariance_of_their_ends() -> None:
    lines_mm, covariance_mm2 = some_lines()
    found = error_ellipsoids(lines_mm, covariance_mm2)
    assert list(zip(found.track, found.end, strict=True)) == [
        *((0, 0), (0, 1), (1, 0), (2, 0), (2, 1), (3, 0), (3, 1))
    ]
    for track, end, centre, axes, sigmas in zip(*found, strict=True):
        block = covariance_mm2[track, 3 * end : 3 * end + 3, 3 * end : 3 * end + 3]
        np.testing.assert_allclose(axes * sigmas**2 @ axes.T, block, atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(axes), 1.0)
        np.testing.assert_array_equal(centre, lines_mm[track, end])


@pytest.mark.parametrize(("sigma", "factor"), [(1e-9, 1000), (0.01, 100), (0.1, 10), (30.0, 1)])
def test_ellipsoids_are_enlarged_until_they_are_seen(sigma: float, factor: int) -> None:
    sigmas = np.full((5, 3), sigma)
    assert visible_factor(sigmas, 100.0) == factor
    assert visible_factor(sigmas[:0], 100.0) == visible_factor(sigmas, 0.0) == 1


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    pytest.importorskip("viser")
    figure = space_figure(table1_rig(), None, None)
    found = error_ellipsoids(*some_lines())
    with serve_space(figure, found, title="a rig") as running:
        yield running


def test_a_page_of_this_machine_sees_the_scene(url: str) -> None:
    assert url.startswith("http://127.0.0.1:")
    status, page = ask(url)
    assert status == 200
    assert "<html" in page


def test_other_names_and_other_pages_are_refused(url: str) -> None:
    assert ask(url, Host="evil.example")[0] == 403
    assert ask(url, Origin="http://evil.example")[0] == 403
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec_WebSocket_Version": "13",
    }
    assert ask(url, Origin="http://evil.example", **upgrade)[0] == 403
    assert ask(url, Host="evil.example", **upgrade)[0] == 403


@pytest.mark.parametrize("path", ["/../__init__.py", "/%2e%2e/__init__.py", "//etc/passwd"])
def test_no_path_leads_out_of_the_folder(url: str, path: str) -> None:
    assert ask(url, path)[0] == 404


def test_a_port_that_is_taken_is_named(url: str) -> None:
    port = int(url.rstrip("/").rpartition(":")[2])
    figure = space_figure(table1_rig(), None, None)
    with (
        pytest.raises(InputError, match=f"Port {port} is taken"),
        serve_space(figure, None, title="again", port=port),
    ):
        pass


def test_stopped_it_answers_no_more(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    with serve_space(space_figure(table1_rig(), None, None), None, title="short") as url:
        pass
    with pytest.raises(ConnectionRefusedError):
        ask(url)
    assert capfd.readouterr().out == ""


def test_without_viser_a_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    figure = space_figure(table1_rig(), None, None)
    with (
        pytest.raises(InputError, match=r"This needs viser: pip install 'trinoc\[view\]'"),
        serve_space(figure, None, title="none"),
    ):
        pass


def test_an_unguarded_viser_is_not_left_running(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    monkeypatch.setattr(space, "_guard_requests", lambda: contextlib.nullcontext([]))
    figure = space_figure(table1_rig(), None, None)
    with (
        pytest.raises(InputError, match="in another way"),
        serve_space(figure, None, title="open"),
    ):
        pass
