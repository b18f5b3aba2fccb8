"""Tables of numbers and of vectors by which formats replace many values with few."""

from __future__ import annotations

import numpy as np

LEAF = 1024  # rows that are compared with one another; time and memory grow with its square
EVEN = 0.75  # share of a table of numbers that lies evenly between its ends, so that nothing rare is far from its nearest


def table_of_numbers(values: np.ndarray, size: int) -> np.ndarray:
    """[size] float32, ascending: numbers so placed that the mean squared distance from ``values`` (any shape, not empty, finite) to their
    nearest is small, and the largest not much more than with even steps."""
    found = np.sort(values, axis=None).astype(np.float64)
    distinct = np.unique(found)
    if len(distinct) <= size:
        return np.concatenate([distinct, np.full(size - len(distinct), distinct[-1])]).astype(np.float32)
    # The best places are as dense as the cube root of the values' density.
    density, edges = np.histogram(found, 4 * size)
    wanted = np.cbrt(density / density.max())
    course = np.concatenate([[0.0], np.cumsum((1 - EVEN) * wanted / wanted.sum() + EVEN / len(wanted))])
    table = np.interp((np.arange(size) + 0.5) / size, course, edges)
    table[[0, -1]] = found[[0, -1]]
    return np.asarray(table.astype(np.float32))


def nearest_numbers(values: np.ndarray, table: np.ndarray) -> np.ndarray:
    """For each of ``values`` (any shape), the index into ``table``, ascending, of the nearest."""
    middles = (table[1:].astype(np.float64) + table[:-1]) / 2
    return np.searchsorted(middles, values)


def table_of_vectors(rows: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most ``most`` vectors [M, D] for ``rows`` [N, D] (float32, finite), and the index [N] of each row's. ``most`` is N / 500 or more;
    where all fit, the vectors are ``rows``.

    Rows that are alike come into groups of `LEAF` or fewer. In each group, the two clusters whose union costs least are joined again and
    again (Ward 1963). All groups stop at the same cost, so that those with varied rows keep more vectors. Time grows with N alone."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(rows) <= most:
        return rows, np.arange(len(rows))
    groups = _groups(rows)
    trees = [linkage(rows[group], "ward") for group in groups]
    bound = np.sort(np.concatenate([tree[:, 2] for tree in trees]))[len(rows) - most - 1]
    index, count = np.zeros(len(rows), np.int64), 0
    for group, tree in zip(groups, trees):
        own = fcluster(tree, bound, "distance")  # from 1
        index[group] = count + own - 1
        count += int(own.max())
    return _means(rows, index), index


def _means(rows: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The means of the clusters ``index`` [N], none of which is empty, of ``rows`` [N, D]."""
    counts = np.bincount(index)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.asarray(np.add.reduceat(rows[np.argsort(index, kind="stable")], starts) / counts[:, None].astype(rows.dtype))


def _groups(rows: np.ndarray) -> list[np.ndarray]:
    """Indices of ``rows`` [N, D] in groups of `LEAF` or fewer: halves, again and again, along the axis in which a group is widest."""
    waiting, found = [np.arange(len(rows))], []
    while waiting:
        group = waiting.pop()
        if len(group) <= LEAF:
            found.append(group)
            continue
        spread = rows[group] - rows[group].mean(0)
        along = spread @ np.linalg.eigh(spread.T @ spread)[1][:, -1]
        order = np.argsort(along, kind="stable")
        waiting += [group[order[len(order) // 2 :]], group[order[: len(order) // 2]]]
    return found
