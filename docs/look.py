"""Open each page of the site in Chromium: 1280 and 400 pixels wide, light and dark.

    make look

leaves pictures in `results/docs/look`, for somebody to look at, and fails if a page is wider than
the window, if formulas or pictures are missing, or if a page loads from elsewhere or logs an error.
`tools/chromium-packages.txt` says what it needs.
"""

from __future__ import annotations

import base64
import itertools
import json
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

WIDTHS = (1280, 400)
MODES = ("light", "dark")

#: The tallest picture [pixels]; what is below is left out.
TALLEST = 16000

#: Formulas are there once MathJax says so; pages without any do not load it.
READY = """document.readyState === "complete" && document.body !== null
    && (window.MathJax?.startup?.promise ?? Promise.resolve()).then(() => true)"""

FAULTS = """(() => {
    const page = document.documentElement, all = (css) => [...document.querySelectorAll(css)];
    const formulas = all(".math").length, drawn = all("mjx-container").length;
    const missing = [...document.images].filter((image) => !image.complete || !image.naturalWidth);
    return [
        ...(page.scrollWidth > page.clientWidth ? [`is ${page.scrollWidth} pixels wide`] : []),
        ...(formulas !== drawn ? [`shows ${drawn} of ${formulas} formulas`] : []),
        ...all("mjx-merror").map((error) => `has a wrong formula, ${error.textContent}`),
        ...missing.map((image) => `has no picture ${image.src}`),
    ];
})()"""


class Browser:
    """A window of Chromium, told what to do in its DevTools protocol."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._events: list[dict[str, Any]] = []
        for domain in ("Page", "Network", "Log", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return what a method answers."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (message := json.loads(self._socket.recv())).get("id") != number:
            self._events.append(message)
        return message.get("result", {})

    def value(self, script: str) -> Any:
        """Return the value of an expression on the page; None if its evaluation fails."""
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        return answer.get("result", {}).get("value")

    def open(self, page: Path, width: int, mode: str) -> list[str]:
        """Open a page, and return what is wrong with it."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": mode}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self._events.clear()
        self.call("Page.navigate", url=page.as_uri())
        for _ in range(200):
            time.sleep(0.1)
            if self.value(READY):
                break
        else:
            return ["is not ready after 20 seconds"]
        return [*self.value(FAULTS), *self._reported()]

    def _reported(self) -> list[str]:
        found = []
        for event in self._events:
            match event:
                case {"method": "Network.requestWillBeSent", "params": {"request": {"url": url}}}:
                    if not url.startswith(("file:", "data:")):
                        found.append(f"loads {url}")
                case {"method": "Log.entryAdded", "params": {"entry": entry}}:
                    found.append(f"logs {entry['text']}")
                case {"method": "Runtime.exceptionThrown", "params": {"exceptionDetails": details}}:
                    found.append(f"raises {details['text']}")
        return found

    def picture(self, width: int) -> bytes:
        """Return the page as a PNG."""
        height = min(self.value("document.documentElement.scrollHeight"), TALLEST)
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)
        return base64.b64decode(answer["data"])


def window(profile: Path) -> str:
    """Return the address of Chromium's window, once it has one.

    Raises:
        TimeoutError: Chromium has no window after 30 seconds.
    """
    for _ in range(60):
        time.sleep(0.5)
        port = profile / "DevToolsActivePort"
        if port.exists():
            address = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
            with urllib.request.urlopen(address) as answer:
                found = [tab for tab in json.load(answer) if tab["type"] == "page"]
            if found:
                return str(found[0]["webSocketDebuggerUrl"])
    raise TimeoutError("Chromium does not start")


def main(site: Path, folder: Path) -> int:
    """Open all pages of a site, and write pictures to a folder; return 1 if something is wrong."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = [page for page in sorted(site.rglob("*.html")) if page.name != "search.html"]
    wrong = 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # Chromium's sandbox needs rights that root lacks in a container; all pages are our own
        options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        options += ["--remote-debugging-port=0", f"--user-data-dir={profile}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        chromium = subprocess.Popen(["chromium", *options, "about:blank"], **quiet)
        try:
            with connect(window(Path(profile)), max_size=None) as socket:
                browser = Browser(socket)
                for page, width, mode in itertools.product(pages, WIDTHS, MODES):
                    faults = browser.open(page.resolve(), width, mode)
                    name = str(page.relative_to(site).with_suffix("")).replace("/", "-")
                    path = folder / f"{name}-{width}-{mode}.png"
                    path.write_bytes(browser.picture(width))
                    for fault in faults:
                        wrong += 1
                        print(f"{path.stem} {fault}", file=sys.stderr)
        finally:
            chromium.terminate()
            chromium.wait()
    print(f"{len(pages)} pages, {wrong} faults: {folder}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
