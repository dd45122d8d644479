"""Access control of the local server: requests from its own page only.

Every page in a browser on this machine can reach a port on the loopback address. A page of another
site may point its own name at 127.0.0.1 (DNS rebinding) and read the answers as its own; the Host
header still has that name. It may also open a WebSocket, which browsers allow across sites; the
Origin header identifies the page.
"""

import re
from collections.abc import Sequence

ADDRESS = "127.0.0.1"

_LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
REFUSAL = "Refused: open this page by its own address, http://127.0.0.1 with its port.\n"


def may_ask(hosts: Sequence[str], origins: Sequence[str]) -> bool:
    """True if a request comes from the server's own page.

    Any port is accepted, because a tunnel (`ssh -L`) may change it.

    hosts, origins : values of the request's Host and Origin headers.
    """
    if len(hosts) != 1 or not _LOCAL.fullmatch(hosts[0]):
        return False
    allowed_origin = f"http://{hosts[0]}".lower()
    return all(origin.lower() == allowed_origin for origin in origins)
