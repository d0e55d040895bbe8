"""A live view: the latest picture, in any browser, from a server on this machine."""

import sys
import threading
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing

_PORT = 8642  # of the address, if it is free
_PAGE = b"""<!doctype html><title>cmp-cl</title>
<style>body { margin: 0; background: #111; display: grid; place-items: center; height: 100vh }
img { max-width: 100vw; max-height: 100vh }</style>
<body><img><script>
let shown = document.images[0], number = 0
function ask() {
    const image = new Image()
    image.onload = () => { shown.replaceWith(image); shown = image; setTimeout(ask, 30) }
    image.onerror = () => setTimeout(ask, 500)
    image.src = "picture?" + number++
}
ask()
</script>
"""
_QUALITY = cv2.IMWRITE_JPEG_QUALITY, 80  # %; 95 has twice the bytes

Draw = Callable[[], NDArray[np.uint8]]


class LiveView(Closing):
    """Shows the latest picture to each browser that opens `address`.

    Only this machine can open it. A picture is drawn when a browser asks for it, so those that come
    faster are left out, and without a browser none is drawn. A page that is open at the end keeps
    the last picture.
    """

    def __init__(self) -> None:
        from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer  # takes .1 s

        self._draw: Draw | None = None
        view = self

        class Page(BaseHTTPRequestHandler):
            timeout = 5  # s, for a browser that takes no picture

            def do_GET(self) -> None:
                view._answer(self)

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        class Server(ThreadingHTTPServer):
            allow_reuse_address = sys.platform != "win32"  # where two could have one port

            def handle_error(self, *_: Any) -> None:
                """A browser that goes away is no error."""

        try:
            self._server = Server(("127.0.0.1", _PORT), Page)
        except OSError:  # another run shows its pictures there
            self._server = Server(("127.0.0.1", 0), Page)
        self.address = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(self, draw: Draw) -> None:
        """Show a picture. draw: returns it, (H, W, 3) uint8 BGR; in another thread, or never."""
        self._draw = draw

    def _answer(self, browser: Any) -> None:
        kind, data = "text/html", _PAGE
        if browser.path.startswith("/picture"):
            if self._draw is None:
                browser.send_error(503, "there is no picture yet")
                return
            kind, data = "image/jpeg", cv2.imencode(".jpg", self._draw(), _QUALITY)[1].tobytes()
        browser.send_response(200)
        browser.send_header("Content-Type", kind)
        browser.send_header("Content-Length", str(len(data)))
        browser.end_headers()
        browser.wfile.write(data)

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
