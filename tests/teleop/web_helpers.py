"""Pages for tests: a headless browser, and a script that only sends which keys are held."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest

PATIENCE = 200.0


def until(holds, what: str, patience: float = PATIENCE):
    """Wait until something holds, and return what it says."""
    end = time.monotonic() + patience
    while not (answer := holds()):
        if time.monotonic() > end:
            pytest.fail(f"{what}: did not happen within {patience:.0f} s")
        time.sleep(0.02)
    return answer


# A software renderer draws as often as it can, a second for each picture, and takes a core away from all other tests.
# This limits it to a few pictures a second.
SELDOM = """(() => {
  const next = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => window.setTimeout(() => next(draw), 100);
  window.cancelAnimationFrame = (request) => window.clearTimeout(request);
})()"""

# Skips drawing: what is in the scene, and where it appears on the screen, is known without a picture.
UNDRAWN = """(() => {
  for (const name of ["clear", "drawArrays", "drawArraysInstanced", "drawElements", "drawElementsInstanced"])
    WebGL2RenderingContext.prototype[name] = () => undefined;
})()"""

# Switches off shadows, which take most of the time, and lowers the resolution. Places on the page keep their units.
COARSE = """(() => {
  window.setInterval(() => {
    const state = window.__viserMutable?.scene?.__r3f?.root?.getState();
    if (!state) return;
    const never = { configurable: true, get: () => false, set: () => undefined };
    Object.defineProperty(state.gl.shadowMap, "enabled", never);
    if (state.viewport.dpr !== RATIO) state.setDpr(RATIO);
  }, 20);
})()"""


def new_page(browser, drawn=False, **options):
    """A new page whose picture of the scene is drawn coarsely, or not at all."""
    page = browser.new_page(**options)
    page.add_init_script(SELDOM)
    page.add_init_script(COARSE.replace("RATIO", "0.25" if drawn else "0.05"))
    if not drawn:
        page.add_init_script(UNDRAWN)
    return page


class Script:
    """Does what the script in a page does, without a page: sends all the time which keys are held."""

    def __init__(self, url: str):
        from websockets.sync.client import connect

        self._line = connect(f"ws://{urlsplit(url).netloc}/spatula/hand", proxy=None)
        self.wanted = json.loads(self._line.recv())["keys"]
        self._keys: list[str] = []
        self._again: str | None = None
        self.frames: int | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    def hold(self, *keys: str) -> None:
        self._keys = list(keys)
        self._say()

    def press_again(self, key: str) -> None:
        """Press and release a key again and again, until something else is held."""
        self._again = key

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._line.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _talk(self):
        while not self._ended.wait(0.05):
            if self._again is not None:
                self._keys = [] if self._keys else [self._again]
            self._say()

    def _say(self):
        with contextlib.suppress(Exception):
            self._line.send(json.dumps({"keys": self._keys, "hidden": False, "frames": self.frames}))


# The first `count` of the vertices that are drawn.
MESH = """([name, count]) => {
  const node = window.__viserMutable?.nodeRefFromName?.[name];
  let found = null;
  node?.traverse((each) => { if (found === null && each.geometry?.attributes?.position) found = each; });
  if (found === null) return null;
  const visible = (each) => each === null || (each.visible && visible(each.parent));
  const { position, normal } = found.geometry.attributes;
  return {
    points: Array.from(position.array.slice(0, 3 * count)),
    smooth: normal?.count === position.count && !found.material.flatShading,
    visible: visible(found),
  };
}"""

HUSH = """() => {
  const buttons = document.querySelectorAll("[class*=Notification] button");
  buttons.forEach((button) => button.click());
  return buttons.length;
}"""

SEEN_AT = """(name) => {
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  const place = nodeRefFromName[name].getWorldPosition(camera.position.clone()).project(camera);
  const box = canvas.getBoundingClientRect();
  return [box.left + (0.5 + 0.5 * place.x) * box.width, box.top + (0.5 - 0.5 * place.y) * box.height];
}"""


def wait_for(page, holds, what):
    """Wait, and let the browser's messages come in meanwhile."""

    def look():
        page.wait_for_timeout(40)
        return holds()

    return until(look, what)


def mesh(page, name, count=0):
    found = page.evaluate(MESH, [name, count])
    if found is not None:
        found["points"] = np.array(found["points"]).reshape(-1, 3)
    return found


def click(page, label):
    page.get_by_role("button", name=label).click()


def steady(page):
    """Wait until the camera has come to where it goes."""
    seen = []

    def still():
        page.wait_for_timeout(150)
        seen.append(page.evaluate("() => window.__viserMutable.camera.matrixWorld.elements.slice()"))
        return len(seen) > 3 and seen[-1] == seen[-2] == seen[-3]

    wait_for(page, still, "a camera that stands still")
