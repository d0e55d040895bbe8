"""A live view: the latest picture, in any browser, from a server on this machine."""

import contextlib
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
<body style="margin:0;background:#111;display:grid;place-items:center;height:100vh">
<img src="pictures" style="max-width:100vw;max-height:100vh">
"""
_PART = b"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n"
_QUALITY = cv2.IMWRITE_JPEG_QUALITY, 80  # %; 95 has twice the bytes
_REPEATED = 0.5  # s, after which a picture is sent again: some browsers show it only then

Draw = Callable[[], NDArray[np.uint8]]


class LiveView(Closing):
    """Shows the latest picture to each browser that opens `address`.

    Only this machine can open it. A picture is drawn when a browser is ready for it, so those
    that come faster are left out, and without a browser none is drawn.
    """

    def __init__(self) -> None:
        from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer  # takes .1 s

        self._changed = threading.Condition()
        self._draw: Draw | None = None
        self._count = 0
        self._open = True
        view = self

        class Page(BaseHTTPRequestHandler):
            timeout = 5  # s, for a browser that takes no picture

            def do_GET(self) -> None:
                view._answer(self)

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        class Server(ThreadingHTTPServer):
            allow_reuse_address = sys.platform != "win32"  # where two could have one port
            daemon_threads = False  # closing waits for the last pictures

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
        with self._changed:
            self._draw = draw
            self._count += 1
            self._changed.notify_all()

    def _answer(self, browser: Any) -> None:
        pictures = browser.path == "/pictures"
        kind = "multipart/x-mixed-replace; boundary=picture" if pictures else "text/html"
        browser.send_response(200)
        browser.send_header("Content-Type", kind)
        browser.end_headers()
        if not pictures:
            browser.wfile.write(_PAGE)
            return
        seen, open_ = 0, True
        with contextlib.suppress(OSError):  # the page is closed
            while open_:
                with self._changed:
                    if self._count == seen:
                        self._changed.wait(_REPEATED)
                    draw, seen, open_ = self._draw, self._count, self._open
                if draw is not None:
                    picture = cv2.imencode(".jpg", draw(), _QUALITY)[1].tobytes()
                    browser.wfile.write(_PART % (len(picture), picture))
            browser.wfile.write(b"--picture--\r\n")

    def close(self) -> None:
        """End the server; a page that is open keeps the last picture."""
        with self._changed:
            self._open = False
            self._count += 1
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
