"""Who may ask a server on this machine: pages of the server itself, and people at the machine.

A port on the loopback address can be reached by every page that the same person's browser shows.
A page of another site may point its own name at 127.0.0.1 (DNS rebinding) and then read the answers
as its own: the Host header still carries that name. It may also open a WebSocket, which browsers
allow across sites: the Origin header tells whose page asked.
"""

import re
from collections.abc import Sequence

ADDRESS = "127.0.0.1"

_LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
REFUSAL = "Refused: open this page by its own address, http://127.0.0.1 with its port.\n"


def may_ask(hosts: Sequence[str], origins: Sequence[str]) -> bool:
    """Whether a request with these Host and Origin headers comes from this machine's own page.

    Any port is taken, because a tunnel (`ssh -L`) may give the server another.
    """
    if len(hosts) != 1 or not _LOCAL.fullmatch(hosts[0]):
        return False
    own = f"http://{hosts[0]}".lower()
    return all(origin.lower() == own for origin in origins)
