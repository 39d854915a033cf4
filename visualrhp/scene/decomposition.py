"""Decomposition of a simple polygon into convex parts, as the physics engine needs them.

A constrained Delaunay triangulation is merged into few convex parts (Hertel and Mehlhorn, 1983). A body pressed against
a thin part could slip to its other side, so thin parts are extended into their neighbours, and parts may overlap. They
are parts of one rigid body and do not collide with each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from visualrhp.scene import geometry
from visualrhp.scene.polygons import MIN_OBJECT_THICKNESS
from visualrhp.types import FloatArray

_LENGTH_TOLERANCE = 1e-9
_AREA_TOLERANCE = 1e-12


def convex_parts(polygon: FloatArray) -> tuple[FloatArray, ...]:
    """Convex polygons [V, 2], counter-clockwise, whose union is the simple, counter-clockwise ``polygon`` [V, 2].

    A convex polygon is returned unchanged, as the only part. Parts may overlap; none has collinear vertices, and each
    is as thick as :data:`MIN_OBJECT_THICKNESS` where the polygon has room for it.
    """
    if geometry.is_convex(polygon):
        return (polygon,)
    merged = [polygon[part] for part in _merge(polygon, _triangulate(polygon))]
    grown = [_thicken(part, merged) for part in merged]
    return tuple(_without_collinear(part) for part in _without_covered(grown))


def _triangulate(polygon: FloatArray) -> list[list[int]]:
    """Vertex indices of a constrained Delaunay triangulation, each triangle counter-clockwise."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(polygon)))
    index = {point: number for number, point in enumerate(map(tuple, polygon.tolist()))}
    corners = [[index[tuple(point)] for point in shapely.get_coordinates(each)[:3].tolist()] for each in triangles]
    return [corner if geometry.signed_area(polygon[corner]) > 0.0 else corner[::-1] for corner in corners]


def _merge(polygon: FloatArray, triangles: list[list[int]]) -> list[list[int]]:
    """Hertel-Mehlhorn: remove every diagonal without which the parts stay convex, those of thin triangles first."""
    part_of = {edge: part for part in triangles for edge in zip(part, part[1:] + part[:1], strict=True)}
    thickness = {edge: geometry.least_width(polygon[part]) for edge, part in part_of.items()}
    diagonals = [(a, b) for a, b in part_of if a < b and (b, a) in part_of]
    diagonals.sort(key=lambda edge: min(thickness[edge], thickness[edge[1], edge[0]]))
    for a, b in diagonals:
        left, right = part_of[a, b], part_of[b, a]
        # Left starts at b and ends at a, right starts at a and ends at b.
        left = _rotated(left, left.index(b))
        right = _rotated(right, right.index(a))
        joined = left + right[1:-1]
        if geometry.is_convex(polygon[joined]):
            part_of |= dict.fromkeys(zip(joined, joined[1:] + joined[:1], strict=True), joined)
            del part_of[a, b], part_of[b, a]
    return list({id(part): part for part in part_of.values()}.values())


def _rotated(part: list[int], first: int) -> list[int]:
    return part[first:] + part[:first]


def _thicken(part: FloatArray, parts: Sequence[FloatArray]) -> FloatArray:
    """Return ``part`` or, if it is thin, a larger convex polygon that contains it, within the union of ``parts``.

    Across an edge shared with a neighbour, the part is extended by the piece of the neighbour within the half planes
    of the part's other edges, so the union is convex by construction.
    """
    thickness = geometry.least_width(part)
    while thickness < MIN_OBJECT_THICKNESS:
        candidates = []
        for side in range(len(part)):
            start, end = part[side], part[(side + 1) % len(part)]
            for neighbour in parts:
                if _shares_edge(neighbour, start, end):
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
    shapes = {number: shapely.Polygon(part) for number, part in enumerate(parts)}
    for number in sorted(shapes, key=lambda number: shapes[number].area):
        rest = shapely.union_all([shape for other, shape in shapes.items() if other != number])
        if shapes[number].difference(rest).area < _AREA_TOLERANCE:
            del shapes[number]
    return [parts[number] for number in shapes]


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
