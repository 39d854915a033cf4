"""Decomposition of a simple polygon into convex parts, as the physics engine needs them.

A constrained Delaunay triangulation is merged into few convex parts (Hertel and Mehlhorn, 1983). A body pressed against
a thin part could slip to its other side, so thin parts are extended into their neighbours, and parts may overlap. They
are parts of one rigid body and do not collide with each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import shapely
from numpy.typing import NDArray

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.contours import collision_outline
from visualrhp.scene.polygons import MIN_OBJECT_THICKNESS
from visualrhp.types import FloatArray

_LENGTH_TOLERANCE = 1e-9
_AREA_TOLERANCE = 1e-12
_MARGIN = 1e-7  # around what is looked for [m]
_MOST_EXTENSIONS = 100

_Edge = tuple[int, int]


def convex_parts(polygon: FloatArray) -> tuple[FloatArray, ...]:
    """Convex polygons [V, 2], counter-clockwise, whose union is the simple, counter-clockwise ``polygon`` [V, 2].

    A convex polygon is returned unchanged, as the only part. Parts may overlap; none has collinear vertices, and each
    is as thick as :data:`MIN_OBJECT_THICKNESS` where the polygon has room for it. Of a polygon with very many vertices,
    they are the parts of its :func:`visualrhp.scene.contours.collision_outline`, so the time is bounded.
    """
    if geometry.is_convex(polygon):
        return (polygon,)
    reduced = collision_outline(polygon)
    if reduced is None:
        raise SceneError(f"an outline of {len(polygon)} vertices is too rough to be decomposed into convex parts")
    polygon, _ = reduced
    if geometry.is_convex(polygon):
        return (polygon,)
    merged = _Neighbours([polygon[part] for part in _merge(polygon, _triangulate(polygon))])
    grown = [_thicken(part, merged) for part in merged.parts]
    return tuple(_without_collinear(part) for part in _without_covered(grown))


def _triangulate(polygon: FloatArray) -> list[list[int]]:
    """Vertex indices of a constrained Delaunay triangulation, each triangle counter-clockwise."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(polygon)))
    index = {point: number for number, point in enumerate(map(tuple, polygon.tolist()))}
    corners = [[index[tuple(point)] for point in shapely.get_coordinates(each)[:3].tolist()] for each in triangles]
    return [corner if geometry.signed_area(polygon[corner]) > 0.0 else corner[::-1] for corner in corners]


def _merge(polygon: FloatArray, triangles: list[list[int]]) -> list[list[int]]:
    """Hertel-Mehlhorn: remove every diagonal without which the parts stay convex, those of thin triangles first.

    A part is a ring of directed edges, each of which knows the vertex before it and the vertex after it. To remove a
    diagonal links the rings of both its sides, and only the angles at its two ends change.
    """
    after = {(a, b): c for t in triangles for a, b, c in (t, t[1:] + t[:1], t[2:] + t[:2])}
    before = dict(after)  # of triangles, the vertex after an edge is also the one before it
    thickness: dict[_Edge, float] = {}
    for triangle in triangles:
        thickness |= dict.fromkeys(_ring(triangle), geometry.least_width(polygon[triangle]))
    diagonals = [(a, b) for a, b in after if a < b and (b, a) in after]
    diagonals.sort(key=lambda edge: min(thickness[edge], thickness[edge[1], edge[0]]))
    points = polygon.tolist()
    extent = float(np.abs(polygon).max())
    first_of: dict[_Edge, int] = {}  # when an edge became the first of its part
    for number, (a, b) in enumerate(diagonals):
        # The left part goes from ``left_before`` over a and b to ``left_after``, the right one over b and a.
        left_before, left_after = before[a, b], after[a, b]
        right_before, right_after = before[b, a], after[b, a]
        if not (
            _is_left_turn(points[left_before], points[a], points[right_after], extent)
            and _is_left_turn(points[right_before], points[b], points[left_after], extent)
        ):
            continue
        after[left_before, a], before[a, right_after] = right_after, left_before
        after[right_before, b], before[b, left_after] = left_after, right_before
        del after[a, b], after[b, a]
        first_of[b, left_after] = number
    return _rings(after, first_of)


def _ring(part: list[int]) -> list[_Edge]:
    return list(zip(part, part[1:] + part[:1], strict=True))


def _is_left_turn(before: list[float], at: list[float], behind: list[float], extent: float) -> bool:
    """Whether a path turns left or, up to rounding, goes straight on (:func:`geometry.is_convex`)."""
    ax, ay, bx, by = at[0] - before[0], at[1] - before[1], behind[0] - at[0], behind[1] - at[1]
    turn = ax * by - ay * bx
    return turn >= 0.0 or turn >= -geometry.turn_tolerance(math.hypot(ax, ay), math.hypot(bx, by), extent)


def _rings(after: dict[_Edge, int], first_of: dict[_Edge, int]) -> list[list[int]]:
    """The vertices of each part, from the edge that became its first one last."""
    parts = []
    seen: set[_Edge] = set()
    for start in after:
        if start in seen:
            continue
        ring, edge = [], start
        while edge not in seen:
            seen.add(edge)
            ring.append(edge)
            edge = (edge[1], after[edge])
        first = max(range(len(ring)), key=lambda number: first_of.get(ring[number], -1))
        parts.append([tail for tail, _ in ring[first:] + ring[:first]])
    return parts


class _Neighbours:
    """Parts of a polygon, and which of them are at a place.

    Args:
        parts: convex polygons [V, 2], counter-clockwise.
    """

    def __init__(self, parts: list[FloatArray]) -> None:
        self.parts = parts
        self._tree = shapely.STRtree([shapely.Polygon(part) for part in parts])

    def along(self, start: FloatArray, end: FloatArray) -> Iterator[FloatArray]:
        """The parts with an edge on which the segment lies, in the opposite direction."""
        middle = shapely.Point(0.5 * (start + end))
        for number in np.sort(self._tree.query(middle, predicate="dwithin", distance=_MARGIN)):
            if _shares_edge(self.parts[number], start, end):
                yield self.parts[number]


def _thicken(part: FloatArray, neighbours: _Neighbours) -> FloatArray:
    """Return ``part`` or, if it is thin, a larger convex polygon that contains it, within the union of the parts.

    Across an edge shared with a neighbour, the part is extended by the piece of the neighbour within the half planes
    of the part's other edges, so the union is convex by construction.
    """
    thickness = geometry.least_width(part)
    for _ in range(_MOST_EXTENSIONS):
        if thickness >= MIN_OBJECT_THICKNESS:
            break
        candidates = []
        for side in range(len(part)):
            for neighbour in neighbours.along(part[side], part[(side + 1) % len(part)]):
                taken = _within_wedge(neighbour, part, side)
                if len(taken) > 2:
                    grown = geometry.convex_hull(np.concatenate([part, taken]))
                    candidates.append((geometry.least_width(grown), geometry.signed_area(grown), grown))
        best = max(candidates, key=lambda candidate: candidate[:2], default=None)
        if best is None or best[1] < geometry.signed_area(part) + _AREA_TOLERANCE:
            break
        thickness, _, part = best
    return part


def _shares_edge(neighbour: FloatArray, start: FloatArray, end: FloatArray) -> bool:
    """Whether the segment lies on an edge of ``neighbour`` in the opposite direction."""
    tails, heads = neighbour, np.concatenate([neighbour[1:], neighbour[:1]])
    along = heads - tails
    lengths = np.hypot(along[:, 0], along[:, 1])
    along = along / lengths[:, None]

    def on_edges(point: FloatArray) -> np.ndarray:
        offset = point - tails
        across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0])
        distance = (along * offset).sum(axis=1)
        return (across < _LENGTH_TOLERANCE) & (distance > -_LENGTH_TOLERANCE) & (distance < lengths + _LENGTH_TOLERANCE)

    opposite = along @ (end - start) < 0.0
    return bool((opposite & on_edges(start) & on_edges(end)).any())


def _within_wedge(neighbour: FloatArray, part: FloatArray, opened: int) -> FloatArray:
    """The piece of a convex ``neighbour`` to the left of every edge of ``part`` except the opened one."""
    for side in range(len(part)):
        if side != opened:
            neighbour = _left_of(neighbour, part[side], part[(side + 1) % len(part)])
            if len(neighbour) < 3:
                break
    return neighbour


def _left_of(polygon: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """The piece of a convex polygon to the left of a line (Sutherland and Hodgman, 1974)."""
    edge = end - start
    heights = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
    kept = []
    for number, height in enumerate(heights):
        following = (number + 1) % len(polygon)
        if height >= 0.0:
            kept.append(polygon[number])
        if (height < 0.0) != (heights[following] < 0.0):
            share = height / (height - heights[following])
            kept.append(polygon[number] + share * (polygon[following] - polygon[number]))
    return np.array(kept).reshape(-1, 2)


def _without_covered(parts: list[FloatArray]) -> list[FloatArray]:
    """Remove the parts that the others cover, small ones first."""
    shapes = np.array([shapely.Polygon(part) for part in parts])
    areas = shapely.area(shapes)
    tree = shapely.STRtree(shapes)
    remain = np.ones(len(parts), dtype=bool)
    for number in sorted(range(len(parts)), key=lambda number: areas[number]):
        others = np.sort(tree.query(shapes[number]))
        others = others[remain[others] & (others != number)]
        if _is_covered(parts[number], shapes[number], shapes[others]):
            remain[number] = False
    return [part for part, stays in zip(parts, remain, strict=True) if stays]


def _is_covered(part: FloatArray, shape: shapely.Polygon, others: NDArray[np.object_]) -> bool:
    """Whether the union of ``others`` covers a convex ``part``; the union of many is made only in case of doubt."""
    if _sticks_out(part, others):
        return False
    if shapely.covers(others, shape).any():
        return True
    return shape.difference(shapely.union_all(others)).area < _AREA_TOLERANCE


def _sticks_out(part: FloatArray, others: NDArray[np.object_]) -> bool:
    """Whether a corner of a convex ``part`` is certainly not covered; cheaper than the union of many others.

    Within the distance r of all others from a corner, the part has at least r^2 sin(angle) / 2 for itself.
    """
    if len(others) == 0:
        return True
    before, after = np.roll(part, 1, axis=0) - part, np.roll(part, -1, axis=0) - part
    lengths = np.hypot(before[:, 0], before[:, 1]), np.hypot(after[:, 0], after[:, 1])
    sines = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) / (lengths[0] * lengths[1])
    reach = np.minimum(*lengths)
    for corner in np.argsort(-lengths[0] - lengths[1]):
        free = min(reach[corner], shapely.distance(shapely.Point(part[corner]), others).min())
        if 0.5 * free**2 * sines[corner] > 2.0 * _AREA_TOLERANCE:
            return True
    return False


def _without_collinear(part: FloatArray) -> FloatArray:
    """Remove vertices that lie on the line through their neighbours."""
    vertices = list(part)
    number = 0
    while number < len(vertices):
        before, at, after = vertices[number - 1], vertices[number], vertices[(number + 1) % len(vertices)]
        chord = after - before
        turn = abs(chord[0] * (at[1] - before[1]) - chord[1] * (at[0] - before[0]))
        if turn <= _LENGTH_TOLERANCE * np.hypot(*chord):
            del vertices[number]
            number = max(number - 1, 0)
        else:
            number += 1
    return np.array(vertices)
