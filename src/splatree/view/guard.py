"""Who may ask the server for anything: a layer around the whole application.

A page of any other site can send requests to this machine from the browser of whoever visits it, also under a name that it lets
point here (DNS rebinding). So a server that only this machine reaches answers to names of this machine only; one that others
reach wants the token of the printed address; and whatever says where it comes from (Origin) has to come from the same address.
The files of the page itself are no secret and need no token.
"""

import hmac
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from splatree.stream.http import LOOPBACK, host_name
from splatree.view.options import ViewOptions

__all__ = ["Guard"]


class Guard:
    """Refuses with 403 what may not ask, before anything looks at it."""

    def __init__(self, app: ASGIApp, options: ViewOptions, token: str | None) -> None:
        self._app, self._options, self._token = app, options, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket") and (reason := self._refusal(scope)):
            if scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": reason})  # before it is accepted: 403
            else:
                await PlainTextResponse(f"splatree view: {reason}\n", 403)(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _refusal(self, scope: Scope) -> str | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self._options.is_local and host_name(host) not in LOOPBACK:
            return f"found Host {host[:80]!r}, wanted a name of this machine, such as localhost"
        origin = headers.get("origin")
        if origin is not None and origin not in self._options.allow_origin and not _is_same(origin, host):
            return f"found Origin {origin[:80]!r}, wanted that of this page; --allow-origin permits others"
        if self._token is not None and not scope["path"].startswith("/page/"):
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[-1]
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return "found no token or a wrong one, wanted the address that splatree view printed"
        return None


def _is_same(origin: str, host: str) -> bool:
    try:
        return urlsplit(origin).netloc.lower() == host.lower() and host != ""
    except ValueError:
        return False
