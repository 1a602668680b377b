"""A headless Chromium, spoken to in its DevTools protocol through a pair of pipes."""

import base64
import contextlib
import io
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_PATIENCE = 120  # seconds until a browser that says nothing is given up


def find_browser() -> str | None:
    """The path of a Chromium; None where there is none."""
    asked = os.environ.get("CHROMIUM")
    return asked or next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in one browser, which reaches no network.

    Attributes:
      requests: addresses that the page asked for, without `data:` and `blob:`.
      errors: what its scripts raised and what its console called an error.
    """

    def __init__(self, to_browser: int, from_browser: int):
        self._write, self._read = to_browser, from_browser
        self._rest, self._count, self._session = b"", 0, None
        self.requests: list[str] = []
        self.errors: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        """The result of a command; events that come before it are noted."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._count:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._note(answer)

    def _receive(self):
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._read], [], [], _PATIENCE)
            read = os.read(self._read, 1 << 20) if ready else b""
            assert read, "the browser ended, or says nothing"
            self._rest += read
        line, _, self._rest = self._rest.partition(b"\0")
        return json.loads(line)

    def _note(self, event):
        params, method = event.get("params", {}), event.get("method")
        if method == "Network.requestWillBeSent":
            url = params["request"]["url"]
            if not url.startswith(("data:", "blob:")):
                self.requests.append(url)
        elif method == "Runtime.exceptionThrown":
            self.errors.append(str(params["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.errors.append(str(params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])

    def open(self, path: Path, *, width: int = 1200, height: int = 900, dark=False):
        """Load a file in a window of that size, and wait until it is loaded."""
        self.requests.clear()
        self.errors.clear()
        window = {"width": width, "height": height, "deviceScaleFactor": 1}
        self.call("Emulation.setDeviceMetricsOverride", **window, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="screen", features=[scheme])
        self.call("Page.navigate", url=Path(path).resolve().as_uri())
        self.wait_for(
            f"location.href.endsWith({json.dumps(Path(path).name)}) "
            "&& document.readyState === 'complete'"
        )

    def ask(self, expression: str):
        """The value of a JavaScript expression, of a promise once it is kept."""
        how = {"awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", expression=expression, **how)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, expression: str):
        """Wait until an expression is true; returns its value."""
        end = time.monotonic() + _PATIENCE
        while not (value := self.ask(expression)):
            assert time.monotonic() < end, f"never came true: {expression}"
            assert not self.errors, self.errors
            time.sleep(0.05)
        return value

    def scroll_to(self, selector: str):
        """Bring what a selector names into the window."""
        self.ask(
            f"document.querySelector({json.dumps(selector)})"
            ".scrollIntoView({block: 'center', behavior: 'instant'})"
        )

    def locate(self, selector: str) -> list[float]:
        """Left, top, width and height of what a selector names, in the window."""
        return self.ask(
            "(b => [b.x, b.y, b.width, b.height])(document.querySelector("
            f"{json.dumps(selector)}).getBoundingClientRect())"
        )

    def drag(self, selector: str, by: tuple[int, int]):
        """Press the mouse in the middle of what a selector names, move, let go."""
        x, y, width, height = self.locate(selector)
        x, y = x + width / 2, y + height / 2
        held = {"button": "left", "buttons": 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **held)
        for part in (0.25, 0.5, 0.75, 1.0):
            place = {"x": x + part * by[0], "y": y + part * by[1]}
            self.call("Input.dispatchMouseEvent", type="mouseMoved", **place, **held)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **place, **held)

    def take_picture(self) -> Image.Image:
        """What the window shows."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")


@contextlib.contextmanager
def opening_browser(path: str):
    """A browser, ended when the context is left."""
    in_browser, to_browser = os.pipe()
    from_browser, out_browser = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # The protocol's pipes are descriptors 3 and 4 of the browser.
        command = (
            'exec 3<&"$0" 4>&"$1"; shift; exec "$@"',
            *map(str, (in_browser, out_browser)),
        )
        process = subprocess.Popen(
            ["bash", "-c", *command, path, *OPTIONS, f"--user-data-dir={profile}"],
            pass_fds=(in_browser, out_browser),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(in_browser)
        os.close(out_browser)
        try:
            yield Browser(to_browser, from_browser)
        finally:
            os.close(to_browser)
            os.close(from_browser)
            process.terminate()
            process.wait(30)


OPTIONS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",  # it cannot be had as root or in most containers
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    # Nothing is fetched from anywhere but this machine.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    # WebGL without a GPU.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
)
