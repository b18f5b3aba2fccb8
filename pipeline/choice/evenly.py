"""A few of many, evenly spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar, overload

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")


@overload
def evenly(items: np.ndarray, most: int) -> np.ndarray: ...
@overload
def evenly(items: Sequence[T], most: int) -> list[T]: ...
def evenly(items: Any, most: int) -> Any:
    """At most ``most`` of the ``items`` in their order, evenly spread, the first and the last among them; the first alone if ``most`` is 1.

    items: an array [N, ...], of which the rows are chosen, or a sequence, for which a list is returned.
    """
    import numpy as np

    places = np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int)
    return items[places] if isinstance(items, np.ndarray) else [items[k] for k in places.tolist()]
