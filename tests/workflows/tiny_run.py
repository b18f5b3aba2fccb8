"""Words of a tiny run that the tests of its page and of the viewer share, and how they start a browser."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

QUICK = ["--set", "coarse.iterations=300", "--set", "hulls.budget=60", "--set", "fine.iterations=20", "--device", "cpu"]
CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update --disable-sync",
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader",
]


@contextmanager
def started() -> Iterator:
    """A real Chromium, as playwright's browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=" ".join(FLAGS).split())
        yield browser
        browser.close()


def environment(**more: str) -> dict[str, str]:
    """Of a process: our own, and ``more``."""
    return {**os.environ, **more}
