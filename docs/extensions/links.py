"""After a build: every link inside the site leads somewhere, and no page loads from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from sphinx.util import logging

logger = logging.getLogger(__name__)


class Page(HTMLParser):
    """What a page links to, loads, and can be linked to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take the attributes of a tag that are links or anchors."""
        given = {name: value for name, value in attrs if value}
        self.anchors.update(given[name] for name in ("id", "name") if name in given)
        if "src" in given:
            self.loaded.append(given["src"])
        if "href" in given:
            loads = tag == "link" and given.get("rel") not in ("search", "index", "next", "prev")
            (self.loaded if loads else self.links).append(given["href"])


def faults(folder: Path) -> list[str]:
    """Return what is wrong with the links of the pages in a folder."""
    pages = {path.resolve(): Page(path.read_text()) for path in sorted(folder.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        for link in [*page.loaded, *page.links]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loaded and parts.scheme != "data":
                    found.append(f"{path.name} loads {link}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchor = unquote(parts.fragment)
            if not target.exists():
                found.append(f"{path.name}: there is no {link}")
            elif anchor and target in pages and anchor not in pages[target].anchors:
                found.append(f"{path.name}: nothing is called {link}")
    return found


def check(app: Any, exception: Exception | None) -> None:
    """Warn of each fault; `sphinx -W` makes that an error."""
    if exception is None and app.builder.format == "html":
        for fault in faults(Path(app.outdir)):
            logger.warning("links: %s", fault)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True}
