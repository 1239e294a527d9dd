"""Who may ask the live window's server for anything."""

import re
import secrets
import socket
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from pinmobile.arrays import text
from pinmobile.errors import InvalidArgument, shown

__all__ = ["Access", "access_for"]

_LOOPBACK = ("127.0.0.1", "::1", "localhost")
_EVERYWHERE = ("0.0.0.0", "::")
_TOKEN = re.compile(r"[A-Za-z0-9._~-]+")


@dataclass(frozen=True)
class Access:
    """The rule for requests.

    Parameters
    ----------
    host : str
        Address that is served.
    token : str, optional
        What each request has to carry.
    """

    host: str
    token: str | None = field(repr=False)

    @property
    def name(self) -> str:
        """The host as an address has it; where all of the machine's are served, the machine's name."""
        if self.host in _EVERYWHERE:
            return socket.gethostname()
        return f"[{self.host}]" if ":" in self.host else self.host

    def address(self, port: int) -> str:
        """Return the page's address at a port, without the token, as messages and logs may have it."""
        return f"http://{self.name}:{port}/"

    @property
    def query(self) -> str:
        """With which the token is carried; nothing where none is needed."""
        return "" if self.token is None else f"?token={self.token}"

    def refusal(self, headers: Mapping[str, str], tokens: Sequence[bytes]) -> str | None:
        """Return why a request is refused, or None.

        Parameters
        ----------
        headers : mapping
            ``Host`` has to name this server: a page elsewhere whose name was made to point here names
            itself. ``Origin``, where a browser sends it, has to be this server's own page.
        tokens : sequence of bytes
            That the request carries.
        """
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if not self._is_own(host):
            return f"this server is not {_printable(host)}"
        if self.token is not None and not (
            len(tokens) == 1 and secrets.compare_digest(tokens[0], self.token.encode())
        ):
            return "the token is missing or wrong: use the whole address that was printed"
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"requests from pages of {_printable(origin)} are not answered"
        return None

    def _is_own(self, netloc: str) -> bool:
        try:
            name = urlsplit(f"//{netloc}").hostname
        except ValueError:
            return False
        if self.host in _EVERYWHERE:
            return bool(name)  # by which name it is reached cannot be known; the token is needed anyway
        return name in (*_LOOPBACK, self.host.lower())


def access_for(host: str, token: str | None) -> Access:
    """Return the rule for a host, with a new token where one is needed; warn where others can reach it.

    Parameters
    ----------
    host : str
        Address to serve at.
    token : str, optional
        What to ask for; by default a random one, and none on loopback.

    Raises
    ------
    InvalidArgument
        If the host is empty, or the token has letters that an address cannot have.
    """
    if not isinstance(host, str) or not host.strip():
        raise InvalidArgument(f"host is {shown(host)}, expected a name or an address such as '127.0.0.1'")
    if token is not None and not (isinstance(token, str) and _TOKEN.fullmatch(token)):
        raise InvalidArgument("token is empty or not made of letters, digits, '-', '.', '_' and '~'")
    host = host.strip()
    bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if bracketed else host
    if set("[]/@?# ") & set(host) or (bracketed and ":" not in host) or text("host", host) != host:
        raise InvalidArgument(
            f"host is {shown(host)}, expected a name or an address such as '127.0.0.1' or '::1'"
        )
    if host.lower() in _LOOPBACK:
        return Access(host.lower(), token)
    warnings.warn(
        f"the viewer listens on {host}: whoever can reach that address and knows the token sees the scene, "
        "and the connection is not encrypted; an SSH tunnel to the default host, 127.0.0.1, avoids both",
        UserWarning,
        stacklevel=3,
    )
    return Access(host, secrets.token_urlsafe(24) if token is None else token)


def _printable(text: str) -> str:
    return repr(text[:80])
