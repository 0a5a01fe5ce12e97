# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A page in a headless Chromium over its DevTools protocol: what it shows, asks for and says, and a hand on it."""

from __future__ import annotations

import base64
import io
import json
import subprocess
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")
from browser_support import CHROMIUM, FLAGS
from matplotlib.image import imread
from websockets.sync.client import connect

PATIENCE = 120.0
#: WebGL without a graphics card; no name but this machine's is looked up
_FLAGS = [
    *(flag for flag in FLAGS if flag != "--disable-gpu" and "resolver" not in flag),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--remote-debugging-port=0"),
]


#: the button with these words
_BUTTON = "[...document.querySelectorAll('button')].find((b) => b.innerText.trim() === '{}')"


def wait_for(condition, what: str):
    """The value of `condition()` once it is true."""
    end = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.1)
    return value


class Page:
    """A page that is open while the context lasts; at its end the console must have had no error.

    size : of what is shown [pixels]; from 800 across on, scene and plots stand side by side. requests : addresses that
    the page asked for, of all kinds. errors : what it wrote to the console as an error.
    """

    def __init__(self, address: str, folder: Path, size: tuple[int, int] = (1000, 600)) -> None:
        self.requests, self.errors, self._number = [], [], 0
        profile = folder / "profile"
        self._browser = subprocess.Popen(
            [CHROMIUM, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = profile / "DevToolsActivePort"
        wait_for(lambda: port.exists() and len(port.read_text().splitlines()) == 2, "Chromium")
        targets = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port.read_text().split()[0]}/json"))
        target = next(each for each in targets if each["type"] == "page")
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None)
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        # the size of a window would count its borders, too
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.call("Page.navigate", url=address)

    def __enter__(self):
        return self

    def __exit__(self, kind, *_exception) -> None:
        self.call("Runtime.evaluate", expression="0")  # what was said before is then known
        self._socket.close()
        self._browser.terminate()
        self._browser.wait()
        assert kind is not None or self.errors == []

    def call(self, method: str, **parameters) -> dict:
        """The result of a method of the protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._note(message.get("method"), message.get("params", {}))

    def _note(self, method: str | None, found: dict) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(found["url"])
        elif (
            method == "Runtime.exceptionThrown"
            or (method == "Runtime.consoleAPICalled" and found["type"] == "error")
            or (method == "Log.entryAdded" and found["entry"]["level"] == "error")
        ):
            self.errors.append(found)

    def value(self, expression: str):
        """The value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait(self, expression: str):
        """The value of an expression once it is true."""
        return wait_for(lambda: self.value(expression), expression)

    def click(self, element: str, across: float = 0.5) -> None:
        """Press and release the mouse on an element, given as an expression, at a share of its width.

        Once it stands still, with nothing before it: what is shown while the page is made may move it.
        """
        place = (
            f"(() => {{ const b = ({element}).getBoundingClientRect();"
            f" return [b.left + {across} * b.width, b.top + b.height / 2]; }})()"
        )
        last = [None]

        def stands() -> bool:
            self.hide_warnings()
            last.append(self.value(place))
            return last[-1] == last[-2]

        wait_for(stands, f"{element} in its place")
        x, y = last[-1]
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, words: str) -> None:
        """Click the button with these words."""
        self.wait(f"!!({_BUTTON.format(words)})")
        self.click(_BUTTON.format(words))

    def press_until(self, words: str, then: str) -> None:
        """Click the button with these words until there is one with others: a first click may meet no listener yet."""

        def changed() -> bool:
            if self.value(f"!!({_BUTTON.format(words)})"):
                self.click(_BUTTON.format(words))
            end = time.monotonic() + 5.0
            while not self.value(f"!!({_BUTTON.format(then)})"):
                if time.monotonic() > end:
                    return False
                time.sleep(0.1)
            return True

        wait_for(changed, f"{then} in place of {words}")

    def hide_warnings(self) -> None:
        """Hide what viser says of software rendering, with a stripe of orange."""
        self.value("document.querySelectorAll('[role=alert]').forEach((each) => { each.style.display = 'none'; })")

    def picture(self) -> np.ndarray:
        """(rows, columns, 3) what the page shows, 0 to 1."""
        data = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return imread(io.BytesIO(data))[:, :, :3]

    def still(self) -> np.ndarray:
        """The picture, as `picture` gives it, once nothing changes any more: a scene is drawn in several passes.

        Without a graphics card a picture of a scene that moves can take half a minute: let it stand before.
        """
        self.hide_warnings()
        last = [self.picture()]

        def same() -> bool:
            last.append(self.picture())
            return np.array_equal(last[-2], last[-1])

        wait_for(same, "a still picture")
        return last[-1]

    def wrists(self) -> np.ndarray:
        """(columns,) pixels of the orange of wrist and elbow in each column of a scene that stands, the left half."""
        red, green, blue = np.moveaxis(self.still(), 2, 0)
        orange = (red > 0.7) & (green > 0.25) & (green < 0.65) & (blue < 0.4) & (red - green > 0.25)
        return orange[:, : orange.shape[1] // 2].sum(axis=0)
