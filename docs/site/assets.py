"""No page of the site may load anything from another host; mkdocs.yml names this file.

Links that a reader follows may lead anywhere.
"""

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

# Tag: the attribute with the address of what a browser loads at once.
LOADED = {
    "audio": "src",
    "embed": "src",
    "iframe": "src",
    "image": "href",
    "img": "src",
    "link": "href",
    "object": "data",
    "script": "src",
    "source": "src",
    "use": "href",
    "video": "src",
}
_OUTSIDE = re.compile(r"\s*(?:[a-z][a-z+.-]*:)?//", flags=re.IGNORECASE)
_CSS = re.compile(r"""(?:url\(|@import)\s*["']?([^"')\s;]+)""")


def on_post_build(config, **_: object) -> None:
    """End the build with a sentence where a page loads something from outside."""
    if found := list(list_outside(Path(config["site_dir"]))):
        raise SystemExit(
            "Error: Pages must load nothing from other hosts, but "
            f"{'; '.join(found[:5])}; put what they need into docs/."
        )


def list_outside(site: Path) -> Iterator[str]:
    """What the pages and styles of a built site load from other hosts."""
    for path in sorted(site.rglob("*")):
        addresses: list[str] = []
        if path.suffix == ".html":
            addresses = _Loaded(path.read_text(encoding="utf-8")).addresses
        elif path.suffix == ".css":
            addresses = _CSS.findall(path.read_text(encoding="utf-8"))
        for address in filter(_OUTSIDE.match, addresses):
            yield f"{path.relative_to(site)} loads {address}"


class _Loaded(HTMLParser):
    """The addresses that a page makes a browser load."""

    def __init__(self, text: str):
        super().__init__()
        self.addresses: list[str] = []
        self._is_style = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = {name: value or "" for name, value in attrs}
        self._is_style = tag == "style"
        # Where a page says its own address or the next one's, nothing is loaded.
        if tag == "link" and given.get("rel") in ("canonical", "next", "prev"):
            return
        if address := given.get(LOADED.get(tag, "")):
            self.addresses.append(address)
        self.addresses += re.findall(
            r"[^\s,]+(?=\s+[\d.]+[wx])", given.get("srcset", "")
        )
        self.addresses += _CSS.findall(given.get("style", ""))
        # The theme's script fetches a library for diagrams, but only where one is.
        if "mermaid" in given.get("class", "").split():
            self.addresses.append("//unpkg.com/mermaid")

    def handle_data(self, data):
        if self._is_style:
            self.addresses += _CSS.findall(data)
            self._is_style = False
