"""Keeps what the web server of the viewer says to itself out of the terminal."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

NOISY = "websockets.server"  # a traceback for everything that is not a browser: HEAD, port scans, connections that break off


def hush() -> None:
    """From now on nothing is said about requests that fail and browsers that are gone."""
    logging.getLogger(NOISY).setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message=r"Queued a \w+ on a closed connection")


@contextmanager
def unsaid() -> Iterator[None]:
    """What is printed in the block, by any thread, is not shown: a banner, and that the server has stopped."""
    with redirect_stdout(io.StringIO()):
        yield
