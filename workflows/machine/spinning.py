"""How long OpenMP's threads wait for one another before they sleep."""

from __future__ import annotations

import os

# Rounds of GNU OpenMP's waiting loop. Its own 300,000 are meant for idle machines: where another program takes one of two cores, training
# of a small clip took 21 s of two threads instead of 7, and one thread took 5.5. On an idle machine both took the same (3.4 to 3.7 s).
ROUNDS = "5000"


def spin_briefly() -> None:
    """For libraries that are loaded after this call. What the user has set stays."""
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", ROUNDS)
