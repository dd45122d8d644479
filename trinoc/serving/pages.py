"""Small web server for this machine: pages generated at each request, no files."""

import contextlib
import http.server
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from trinoc.errors import InputError
from trinoc.serving.loopback import ADDRESS, REFUSAL, may_ask

_TEXT = "text/plain; charset=utf-8"
_STALLED_S = 10.0
_LOOK_FOR_STOP_S = 0.1
# Pages load nothing from other hosts and run no script, even if a file name contains code.
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


class PageContent(NamedTuple):
    """Response of the server: media type and bytes."""

    media_type: str
    content: bytes


@contextlib.contextmanager
def serve_pages(pages: Mapping[str, Callable[[], PageContent]], *, port: int = 0) -> Iterator[str]:
    """Context manager that serves pages over HTTP on this machine, and yields the address of "/".

    Raises InputError if the port is in use.

    pages : function for each path, such as "/", that generates the content.
    port : port; 0 for a free one.
    """
    handler = type("_Handler", (_Handler,), {"pages": dict(pages)})
    try:
        server = http.server.ThreadingHTTPServer((ADDRESS, port), handler)
    except (OSError, OverflowError) as error:
        raise InputError(
            f"Port {port} is in use. Give another --port, or omit it for a free one."
        ) from error
    server.daemon_threads = True
    with server:
        thread = threading.Thread(
            target=server.serve_forever, args=(_LOOK_FOR_STOP_S,), daemon=True
        )
        thread.start()
        try:
            yield f"http://{ADDRESS}:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()


class _Handler(http.server.BaseHTTPRequestHandler):
    """Handler of HTTP requests. Only GET is supported."""

    pages: Mapping[str, Callable[[], PageContent]]
    server_version, sys_version = "trinoc", ""
    timeout = _STALLED_S

    def do_GET(self) -> None:
        make = self.pages.get(self.path.partition("?")[0])
        if not may_ask(self.headers.get_all("Host") or [], self.headers.get_all("Origin") or []):
            self._send(403, PageContent(_TEXT, REFUSAL.encode()))
        elif make is None:
            self._send(404, PageContent(_TEXT, b"There is no such page.\n"))
        else:
            self._send(200, make())

    def _send(self, status: int, page: PageContent) -> None:
        self.send_response(status)
        for name, value in _SECURITY.items():
            self.send_header(name, value)
        self.send_header("Content-Type", page.media_type)
        self.send_header("Content-Length", str(len(page.content)))
        self.end_headers()
        self.wfile.write(page.content)

    def log_message(self, format: str, *args: object) -> None:
        """Suppress the log: stderr is for the command's own lines."""
