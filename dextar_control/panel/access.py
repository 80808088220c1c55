"""Who may see and drive is decided by the address that a request names, the page that
it comes from, and a token.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from urllib.parse import urlsplit


class Access:
    """Decides which requests a panel lets in.

    Bound to this machine alone it answers requests that name this machine (a foreign
    name that was made to lead here, as a page of the internet may try, is refused).
    Bound to anything else it wants its token. From a browser it wants its own page.

    Args:
        host: the address that it is bound to.

    Attributes:
        token: what a request has to carry; empty where none is needed.
    """

    def __init__(self, host: str) -> None:
        self.token = "" if _is_here(host) else secrets.token_urlsafe(16)

    def refusal(self, host: str, origin: str | None, token: str) -> str:
        """Return why a request is refused, in a sentence; empty where it is not.

        Args:
            host: the name and port that it asked.
            origin: of the page that asks; None for what is no browser, or a page that
                is asked for itself.
            token: that it carries.
        """
        try:
            asker = urlsplit(origin or "").netloc
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:  # brackets that do not close
            return (
                "the request names no host and port: open the address that the panel"
                " printed"
            )
        if origin is not None and asker.lower() != host.lower():
            return (
                f"a page of {origin} may not ask the panel at {host}: open the address"
                " that the panel printed"
            )
        if self.token and not hmac.compare_digest(token.encode(), self.token.encode()):
            return (
                "the token is missing or wrong: open the address that the panel"
                " printed, token included"
            )
        if not self.token and not _is_here(name):
            return (
                f"the panel is for this machine alone, not for {host}: set its"
                " parameter host to open it"
            )
        return ""


def _is_here(name: str) -> bool:
    """Return whether a host's name or address is this machine's own loop."""
    try:
        return name.lower() == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False
