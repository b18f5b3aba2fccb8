"""The reconstruction: from a capture to a model that renders any view at any time, and its metrics.

Each stage names its own inputs; this is the order in which stages run. `e4dgs plan CAPTURE` shows which of them a capture needs.

    frames ── poses ── depth ── flow ── seeds ── coarse ── hulls ── fine ── evaluate
"""

from ..pipeline import Graph


def reconstruction() -> Graph:
    """The stages in order; the class of each says what it makes."""
    from ..stages.coarse.stage import Coarse
    from ..stages.depth.stage import Depth
    from ..stages.evaluate.stage import Evaluate
    from ..stages.fine.stage import Fine
    from ..stages.flow.stage import Flow
    from ..stages.frames.stage import Frames
    from ..stages.hulls.stage import Hulls
    from ..stages.poses.stage import Poses
    from ..stages.seeds.stage import Seeds

    return Graph([Frames(), Poses(), Depth(), Flow(), Seeds(), Coarse(), Hulls(), Fine(), Evaluate()])


TRAINING = ("seeds", "coarse", "hulls", "fine")  # stages whose time is the training time of metrics.json
EVALUATION = "evaluate"
LIBRARIES = ("numpy", "scipy", "torch", "zarr", "pycolmap", "opencv-contrib-python-headless", "av", "pillow", "pydantic")
