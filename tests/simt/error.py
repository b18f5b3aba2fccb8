"""The one error of this package."""


class SimtError(RuntimeError):
    """A kernel that does not compile, cannot be launched with these arguments, or did what CUDA leaves undefined."""
