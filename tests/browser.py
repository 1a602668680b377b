"""A page in a headless Chromium, by Playwright."""

import contextlib
import io
import os
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_PATIENCE = 120_000  # milliseconds until a page that says nothing is given up
_OPTIONS = (
    # Nothing is fetched from anywhere but this machine.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    # WebGL without a GPU.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def find_browser() -> str | None:
    """The path of a Chromium; None where there is none."""
    asked = os.environ.get("CHROMIUM")
    return asked or next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page.

    Attributes:
      requests: addresses that the page asked for, without `data:` and `blob:`.
      errors: what its scripts raised and what its console called an error.
    """

    def __init__(self, page: Page):
        self.page = page
        page.set_default_timeout(_PATIENCE)
        self.requests: list[str] = []
        self.errors: list[str] = []
        page.on("request", lambda request: self._note_request(request.url))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._note_message)

    def _note_request(self, url):
        if not url.startswith(("data:", "blob:")):
            self.requests.append(url)

    def _note_message(self, message):
        if message.type == "error":
            self.errors.append(message.text)

    def open(self, path: Path, *, width: int = 1200, height: int = 900, dark=False):
        """Load a file in a window of that size, and wait until it is loaded."""
        self.requests.clear()
        self.errors.clear()
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.emulate_media(color_scheme="dark" if dark else "light")
        self.page.goto(path.resolve().as_uri())

    def ask(self, expression: str):
        """The value of a JavaScript expression, of a promise once it is kept."""
        return self.page.evaluate(expression)

    def wait_for(self, expression: str):
        """Wait until an expression is true; returns its value."""
        return self.page.wait_for_function(expression).json_value()

    def scroll_to(self, selector: str):
        """Bring what a selector names into the middle of the window."""
        how = "e => e.scrollIntoView({block: 'center', behavior: 'instant'})"
        self.page.eval_on_selector(selector, how)

    def locate(self, selector: str) -> list[float]:
        """Left, top, width and height of what a selector names, in the window."""
        box = self.page.locator(selector).bounding_box()
        assert box, f"{selector} is not shown"
        return [box[name] for name in ("x", "y", "width", "height")]

    def drag(self, selector: str, by: tuple[int, int]):
        """Press the mouse in the middle of what a selector names, move, let go."""
        x, y, width, height = self.locate(selector)
        x, y = x + width / 2, y + height / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + by[0], y + by[1], steps=4)
        self.page.mouse.up()

    def take_picture(self) -> Image.Image:
        """What the window shows."""
        return Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")


@contextlib.contextmanager
def opening_browser(path: str):
    """A browser, ended when the context is left."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_OPTIONS)
        yield Browser(browser.new_page())
        browser.close()
