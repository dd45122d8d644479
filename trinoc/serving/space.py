"""A rig, its sheet and its 3-D segments in a browser, to turn, drawn by viser."""

import contextlib
import inspect
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import UInt8

from trinoc.errors import InputError, expect_extra
from trinoc.report.space_content import COLOUR_OF_ROLE, Ellipsoids, visible_factor
from trinoc.report.space_part import LineLayer, SpaceFigure
from trinoc.serving.loopback import ADDRESS, REFUSAL, may_ask

_LINE_PX = 2.5
# Size of a dot in that of all dots together.
_DOT_SHARE = 0.012
_GREY = "#8a8a8a"


@contextlib.contextmanager
def serve_space(
    figure: SpaceFigure, ellipsoids: Ellipsoids | None, *, title: str, port: int = 0
) -> Iterator[str]:
    """Serve a view as long as the block runs, to whom `may_ask` lets; yields the address.

    Raises InputError where viser is missing, or where the port is taken.
    """
    expect_extra("viser", "view")
    import viser

    # viser greets on stdout, which holds results.
    with _guard_requests() as guarded, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=ADDRESS, port=port, label=title, verbose=False)
    try:
        if not guarded:
            raise InputError(
                "This version of viser starts its server in another way: update trinoc."
            )
        if port not in (0, server.get_port()):
            raise InputError(
                f"Port {port} is taken: give another --port, or leave it out for a free one."
            )
        # viser can lend a scene to everybody through a relay of its own, at the press of a button.
        server.request_share_url = lambda *_, **__: None
        server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False)
        _draw(server, figure, ellipsoids)
        yield f"http://{ADDRESS}:{server.get_port()}/"
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


@contextlib.contextmanager
def _guard_requests() -> Iterator[list[bool]]:
    """viser has no setting for whom to answer: what it starts is given the check on the way.

    Yields a list that is filled once a server was given it.
    """
    import websockets.asyncio.server as websockets_server

    plain, given = websockets_server.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            headers = request.headers
            if not may_ask(headers.get_all("Host"), headers.get_all("Origin")):
                return connection.respond(403, REFUSAL)
            answer = process_request(connection, request)
            return await answer if inspect.isawaitable(answer) else answer

        given.append(True)
        return plain(*arguments, process_request=checked, **options)

    websockets_server.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield given
    finally:
        websockets_server.serve = plain


def _draw(server: Any, figure: SpaceFigure, ellipsoids: Ellipsoids | None) -> None:
    for number, layer in enumerate(figure.layers):
        if layer.parts:
            _switch(server.gui, layer.name, _add_layer(server.scene, f"/layers/{number}", layer))
    for number, label in enumerate(figure.labels):
        server.scene.add_label(f"/labels/{number}", label.text, position=label.at_mm)
    size_mm = 0.0
    if figure.views:
        box, azimuth = figure.views[0].box, figure.views[0].azimuth
        middle, size_mm = (
            (box.low_mm + box.high_mm) / 2,
            float(np.linalg.norm(box.high_mm - box.low_mm)),
        )
        # From the figure's own side, a little from above.
        eye = np.array([np.cos(azimuth), np.sin(azimuth), 0.7])
        server.initial_camera.position = middle + 0.8 * size_mm * eye / np.linalg.norm(eye)
        server.initial_camera.look_at = middle
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.initial_camera.far = max(1000.0, 100 * size_mm)
    if ellipsoids is not None and len(ellipsoids.track):
        _add_ellipsoids(server, figure, ellipsoids, size_mm)


def _colour(role: str) -> UInt8[np.ndarray, "3"]:
    """Red, green, blue."""
    return np.array(list(bytes.fromhex(COLOUR_OF_ROLE.get(role, _GREY)[1:7])), dtype=np.uint8)


def _add_layer(scene: Any, name: str, layer: LineLayer) -> Any:
    """Its lines, or its dots where parts are single points."""
    lines, colour = [part for part in layer.parts if len(part) > 1], _colour(layer.role)
    if not lines:
        dots = np.stack([part[0] for part in layer.parts])
        size = _DOT_SHARE * float(np.ptp(dots, axis=0).max())
        colours = np.tile(colour, (len(dots), 1))
        return scene.add_point_cloud(name, dots, colours, point_size=size, visible=layer.shown)
    pieces = np.concatenate([np.stack([part[:-1], part[1:]], axis=1) for part in lines])
    return scene.add_line_segments(
        name,
        pieces.astype(np.float32),
        colour,
        thickness=_LINE_PX,
        thickness_units="screen",
        visible=layer.shown,
    )


def _switch(gui: Any, name: str, handle: Any) -> None:
    box = gui.add_checkbox(name, handle.visible)
    box.on_update(lambda _: setattr(handle, "visible", box.value))


def _add_ellipsoids(
    server: Any, figure: SpaceFigure, ellipsoids: Ellipsoids, size_mm: float
) -> None:
    """Ellipsoids with a switch, a factor, and what is known of the one that is clicked."""
    import trimesh
    import viser.transforms

    ball = trimesh.creation.icosphere(subdivisions=2)
    begin = visible_factor(ellipsoids.sigmas_mm, size_mm)
    handle = server.scene.add_batched_meshes_simple(
        "/ellipsoids",
        np.asarray(ball.vertices, dtype=np.float32),
        np.asarray(ball.faces, dtype=np.uint32),
        batched_wxyzs=viser.transforms.SO3.from_matrix(ellipsoids.axes).wxyz,
        batched_positions=ellipsoids.centres_mm,
        batched_scales=begin * ellipsoids.sigmas_mm,
        batched_colors=tuple(_colour("ellipsoids").tolist()),
        opacity=0.55,
        lod="off",
        cast_shadow=False,
        receive_shadow=False,
    )
    _switch(server.gui, "error ellipsoids of the ends, 1 sigma", handle)
    factor = server.gui.add_slider(
        "ellipsoids enlarged", min=0.0, max=3.0, step=0.25, initial_value=float(np.log10(begin)),
        marks=((0.0, "1"), (1.0, "10"), (2.0, "100"), (3.0, "1000")),
    )  # fmt: skip
    said = server.gui.add_text("clicked", "an ellipsoid tells its track", multiline=True)
    said.disabled = True
    words = {
        track: text for layer in figure.layers for track, text in zip(layer.tracks, layer.words)
    }

    @factor.on_update
    def _(_: Any) -> None:
        handle.batched_scales = (10**factor.value * ellipsoids.sigmas_mm).astype(np.float32)

    @handle.on_click
    def _(event: Any) -> None:
        track = int(ellipsoids.track[event.instance_index])
        said.value = words.get(track, f"track {track}").replace(". ", ".\n").replace("; ", "\n")
