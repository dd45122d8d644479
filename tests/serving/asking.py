"""One request as a browser would send it, with any headers."""

import http.client
from urllib.parse import urlsplit


def ask(url: str, path: str = "/", **headers: str) -> tuple[int, str]:
    """Send a request and return (status, text). Underscores in header names become hyphens."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=20)
    try:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request("GET", path, headers=named)
        answer = connection.getresponse()
        return answer.status, answer.read().decode("utf-8", errors="replace")
    finally:
        connection.close()
