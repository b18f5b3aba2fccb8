"""A motion of the tests: see `docs/extending.md`."""
