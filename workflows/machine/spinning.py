"""Limits how long OpenMP's threads spin while they wait for one another, before they sleep."""

from __future__ import annotations

import os

# Rounds of GNU OpenMP's waiting loop. Its default of 300,000 suits idle machines. With another program on one of two cores, training on a
# small clip took 21 s on two threads instead of 7 s, and 5.5 s on one thread. On an idle machine both settings took 3.4 to 3.7 s.
ROUNDS = "5000"


def spin_briefly() -> None:
    """Applies to libraries that are loaded after this call. The user's own settings stay."""
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", ROUNDS)
