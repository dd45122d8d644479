"""A small web server for this machine: a few pages made anew at each request, and nothing else."""

import http.server
import threading
from collections.abc import Callable, Mapping
from typing import NamedTuple

from trinoc.errors import InputError
from trinoc.serving.loopback import ADDRESS, REFUSAL, may_ask

_STALLED_S = 10.0
_LOOK_FOR_STOP_S = 0.1
# A page takes nothing from elsewhere and runs no script, whatever names of files may hold.
_SECURITY = {
    "Content-Security-Policy": (
        "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Page(NamedTuple):
    """What is sent: its media type and its bytes."""

    media_type: str
    content: bytes


class PageServer:
    """Pages by their paths, such as "/"; no file is served. Leave it as a context, or call `stop`.

    Raises InputError where the port is taken.
    """

    def __init__(self, pages: Mapping[str, Callable[[], Page]], *, port: int = 0) -> None:
        handler = type("_Handler", (_Handler,), {"pages": dict(pages)})
        try:
            self._server = http.server.ThreadingHTTPServer((ADDRESS, port), handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"Port {port} is taken: give another --port, or none for a free one."
            ) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(_LOOK_FOR_STOP_S,), daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """Where to look."""
        return f"http://{ADDRESS}:{self._server.server_port}/"

    def stop(self) -> None:
        """Close the port."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> "PageServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


class _Handler(http.server.BaseHTTPRequestHandler):
    """One request. Only GET is answered."""

    pages: Mapping[str, Callable[[], Page]]
    server_version, sys_version = "trinoc", ""
    timeout = _STALLED_S

    def do_GET(self) -> None:
        if not may_ask(self.headers.get_all("Host") or [], self.headers.get_all("Origin") or []):
            self._send(403, Page("text/plain; charset=utf-8", REFUSAL.encode()))
            return
        make = self.pages.get(self.path.partition("?")[0])
        if make is None:
            self._send(404, Page("text/plain; charset=utf-8", b"There is no such page.\n"))
            return
        self._send(200, make())

    def _send(self, status: int, page: Page) -> None:
        self.send_response(status)
        for name, value in _SECURITY.items():
            self.send_header(name, value)
        self.send_header("Content-Type", page.media_type)
        self.send_header("Content-Length", str(len(page.content)))
        self.end_headers()
        self.wfile.write(page.content)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: stderr has the command's own lines."""
