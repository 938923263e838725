"""A headless browser for tests of pages."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SWITCHES = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-gpu-compositing",
    "--disable-quic",
    "--disable-sync",
    "--no-first-run",
)


def find_browser() -> str | None:
    """A Chromium that runs; None for Playwright's own."""
    for name in BROWSERS:
        path = shutil.which(name)
        if path and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0:
            return path
    return None


@contextlib.contextmanager
def open_browser(*switches: str):
    """A browser, or a skipped test where there is none; on CI a failed one."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the extra dev is not installed")
    with playwright.sync_playwright() as started:
        path = find_browser()
        if path is None and not os.path.exists(started.chromium.executable_path):
            answer = pytest.fail if os.environ.get("CI") else pytest.skip
            answer("there is no Chromium: make test installs it, or apt-get install chromium")
        browser = started.chromium.launch(executable_path=path, args=[*SWITCHES, *switches])
        try:
            yield browser
        finally:
            browser.close()
