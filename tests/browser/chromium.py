"""A headless Chromium that is spoken to over pipes (Chrome DevTools Protocol): no port, no driver, no package."""

import contextlib
import json
import os
import select
import shutil
import signal
import time

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-extensions",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
    "--mute-audio", "--host-resolver-rules=MAP * ~NOTFOUND", "--remote-debugging-pipe",
)  # fmt: skip
PATIENCE = 60.0


def found():
    """Path of a browser: what NOISEID_BROWSER names, else the first of the usual names; None without one."""
    return os.environ.get("NOISEID_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)


class Chromium:
    """One browser with one page; what the page says and asks for is kept in ``events``."""

    def __init__(self, profile):
        self.events, self._answers, self._rest, self._number = [], {}, b"", 0
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        command = [found(), *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        quiet = [(os.POSIX_SPAWN_OPEN, n, os.devnull, os.O_RDWR, 0) for n in (0, 1, 2)]
        # The protocol wants file descriptors 3 and 4.
        talk = [(os.POSIX_SPAWN_DUP2, theirs_in, 3), (os.POSIX_SPAWN_DUP2, theirs_out, 4)]
        self._process = os.posix_spawn(command[0], command, os.environ, file_actions=[*quiet, *talk])
        os.close(theirs_in)
        os.close(theirs_out)
        self._session = None
        targets = self.send("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        self._session = self.send("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def close(self):
        """End the browser."""
        with contextlib.suppress(OSError, TimeoutError):
            self._session = None
            self.send("Browser.close")
        os.close(self._out)
        os.close(self._in)
        end = time.monotonic() + 10
        while os.waitpid(self._process, os.WNOHANG) == (0, 0):
            if time.monotonic() > end:
                os.kill(self._process, signal.SIGKILL)
            time.sleep(0.02)

    def send(self, method, **params):
        """Give a command and wait for its answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        number = self._number
        self._listen(lambda: number in self._answers)
        answer = self._answers.pop(number)
        assert "error" not in answer, answer
        return answer["result"]

    def _listen(self, enough):
        end = time.monotonic() + PATIENCE
        while not enough():
            if not select.select([self._in], [], [], max(end - time.monotonic(), 0))[0]:
                raise TimeoutError("the browser does not answer")
            piece = os.read(self._in, 1 << 16)
            if not piece:
                raise OSError("the browser is gone")
            *messages, self._rest = (self._rest + piece).split(b"\0")
            for message in map(json.loads, messages):
                if "id" in message:
                    self._answers[message["id"]] = message
                else:
                    self.events.append(message)

    def open(self, path):
        """Load a file and wait until it is there."""
        self.events.clear()
        self.send("Page.navigate", url=path.as_uri())
        self._listen(lambda: any(e["method"] == "Page.loadEventFired" for e in self.events))

    def show(self, width, scheme="light", media=""):
        """Width of the window, colour scheme, and ``print`` for the page as it goes to paper."""
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.send("Emulation.setEmulatedMedia", media=media, features=features)

    def ask(self, expression):
        """Value of a JavaScript expression in the page; promises are awaited."""
        answer = self.send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")
