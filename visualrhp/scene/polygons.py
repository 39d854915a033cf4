"""Validation of polygons as surfaces and as outlines of rigid bodies."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.contours import (
    MAX_CONTACT_TOLERANCE,
    MAX_EXACT_VERTICES,
    MAX_VERTICES,
    collision_outline,
    numbers,
)
from visualrhp.types import FloatArray

MIN_OBJECT_AREA = 1e-5
"""Smallest area of an object or a surface [m^2]; below it (3 mm x 3 mm) the outline counts as degenerate."""

MIN_OBJECT_THICKNESS = 3e-3
"""Least thickness of an object [m]: bodies could pass through a thinner one in one time step.

For a convex outline, it is the least width. For any other outline, it is the least width of a neck, and of an arm that
is longer than twice this thickness: the pointed end of an arm may be thinner.
"""

MAX_COORDINATE = 100.0
"""Largest absolute coordinate [m] of a vertex or a position: a larger one is probably in millimetres."""

_VERTEX_TOLERANCE = 1e-9
_MANY_VERTICES = 2000  # of a body: the disc is rolled through its collision outline


class PolygonFault(NamedTuple):
    """A defect of a polygon.

    Attributes:
        vertex: index of the vertex at fault, or None if the fault is in the polygon as a whole.
        message: the problem and the expected value, without a subject: "runs clockwise; ...".
    """

    vertex: int | None
    message: str


def polygon_fault(polygon: FloatArray, solid: bool) -> PolygonFault | None:
    """The first fault of a polygon [V, 2], or None if it is simple, counter-clockwise and not degenerate.

    Args:
        polygon: vertices [m].
        solid: whether it outlines a body, which must not be thin or have a vertex within a straight edge.
    """
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        return PolygonFault(None, f"needs at least three vertices (x, y), not an array of shape {list(polygon.shape)}")
    if len(polygon) > MAX_VERTICES:
        return PolygonFault(
            None,
            f"has {len(polygon)} vertices; at most {MAX_VERTICES} are possible, and under 100 are fast to simulate: "
            "ObjectShape.from_contour(points, tolerance) reduces their number",
        )
    if not np.abs(polygon).max() <= MAX_COORDINATE:
        return _unbounded(polygon)
    edges = np.concatenate([polygon[1:], polygon[:1]]) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    if lengths.min() <= _VERTEX_TOLERANCE:
        return _duplicate(polygon, int(np.argmin(lengths)))
    shape = shapely.Polygon(polygon)
    if not shape.is_valid:
        return _crossing(polygon, shape)
    area = geometry.signed_area(polygon)
    if area < 0.0:
        return PolygonFault(None, "runs clockwise; list the vertices in reverse order, counter-clockwise")
    if area < MIN_OBJECT_AREA:
        return PolygonFault(None, f"has the area {area:.3g} m^2; at least {MIN_OBJECT_AREA:g} m^2 is needed")
    return _fault_of_body(polygon, edges) if solid else None


def _fault_of_body(polygon: FloatArray, edges: FloatArray) -> PolygonFault | None:
    before = np.concatenate([edges[-1:], edges[:-1]])
    turns = before[:, 0] * edges[:, 1] - before[:, 1] * edges[:, 0]
    chords = before + edges
    offsets = np.abs(turns) / np.hypot(chords[:, 0], chords[:, 1])  # of each vertex from the line of its neighbours
    if offsets.min() <= _VERTEX_TOLERANCE:
        vertex = int(np.argmin(offsets))
        point = polygon[vertex].tolist()
        return PolygonFault(vertex, f"has collinear vertices: {point} lies on the line of its neighbours; remove it")
    if geometry.is_convex(polygon):
        thickness = geometry.least_width(polygon)
        if thickness < MIN_OBJECT_THICKNESS:
            needed = f"at least {1e3 * MIN_OBJECT_THICKNESS:g} mm is needed"
            return PolygonFault(None, f"is too thin: {1e3 * thickness:.3g} mm wide; {needed}")
        return None
    reduced = collision_outline(polygon)
    if reduced is None:
        return PolygonFault(
            None,
            f"has {len(polygon)} vertices and is rough; an outline that is not convex has at most {MAX_EXACT_VERTICES},"
            f" or is smooth within {1e3 * MAX_CONTACT_TOLERANCE:g} mm: ObjectShape.from_contour(points, tolerance) "
            "reduces their number",
        )
    # The time of a buffer grows with the square of a rough border's length.
    return _thin_spot(polygon, reduced[0] if len(polygon) > _MANY_VERTICES else polygon)


def _thin_spot(polygon: FloatArray, outline: FloatArray) -> PolygonFault | None:
    """The place where a non-convex polygon is thinner than the least thickness, found by rolling a disc through it.

    The disc rolls through ``outline``, the polygon or a similar one.
    """
    radius = 0.5 * MIN_OBJECT_THICKNESS * (1.0 - 1e-6)
    core = shapely.Polygon(outline).buffer(-radius)  # where the centre of the disc can be
    needed = f"at least {1e3 * MIN_OBJECT_THICKNESS:g} mm is needed"
    if core.is_empty:
        return PolygonFault(None, f"is too thin everywhere; {needed}")
    shapely.prepare(core)
    reach = 2.0 * MIN_OBJECT_THICKNESS + radius
    far = np.flatnonzero(~shapely.dwithin(core, shapely.points(polygon), reach * (1.0 - 1e-9)))
    distances = np.asarray(shapely.distance(core, shapely.points(polygon[far])))  # takes long for many
    if len(far) and distances.max() > reach:
        vertex = int(far[np.argmax(distances)])
        return PolygonFault(vertex, f"is too thin around {polygon[vertex].tolist()}; {needed}")
    pieces = shapely.get_parts(core)
    if len(pieces) > 1:
        first, second = pieces[0], shapely.union_all(pieces[1:])
        neck = shapely.get_coordinates(shapely.shortest_line(first, second)).mean(axis=0)
        return PolygonFault(None, f"has a neck around {neck.tolist()} that is too thin; {needed}")
    return None


def _unbounded(polygon: FloatArray) -> PolygonFault:
    finite = np.isfinite(polygon).all(axis=1)
    if not finite.all():
        vertex = int(np.argmin(finite))
        return PolygonFault(vertex, f"has a vertex that is not finite: {polygon[vertex].tolist()}")
    vertex = int(np.argmax(np.abs(polygon).max(axis=1)))
    return PolygonFault(
        vertex, f"has the vertex {polygon[vertex].tolist()}, beyond {MAX_COORDINATE:g} m; coordinates are in metres"
    )


def _duplicate(polygon: FloatArray, vertex: int) -> PolygonFault:
    following = (vertex + 1) % len(polygon)
    if following == 0:
        point = polygon[vertex].tolist()
        return PolygonFault(
            vertex, f"repeats its first vertex {point} at its end; polygons are closed implicitly, so remove it"
        )
    return PolygonFault(following, f"has the duplicate vertex {polygon[following].tolist()}; remove it")


def _crossing(polygon: FloatArray, shape: shapely.Polygon) -> PolygonFault:
    """The fault of a polygon that crosses or touches itself, with the vertex nearest to the intersection."""
    spread = np.linalg.matrix_rank(polygon - polygon[0], tol=_VERTEX_TOLERANCE)
    if spread < 2:
        return PolygonFault(None, "has collinear vertices only, so it spans no area")
    place = re.search(r"\[(\S+) (\S+)\]", shapely.is_valid_reason(shape))
    vertex, where = None, ""
    if place:
        point = np.array([float(place[1]), float(place[2])])
        vertex = int(np.argmin(np.hypot(*(polygon - point).T)))
        where = f" at ({point[0]:.4g}, {point[1]:.4g})"
    return PolygonFault(vertex, f"crosses or touches itself{where}; give a simple polygon")


def checked_polygon(values: npt.ArrayLike, what: str, solid: bool) -> FloatArray:
    """A read-only copy [V, 2] of a simple, counter-clockwise polygon; ``solid`` as in :func:`polygon_fault`.

    Raises:
        SceneError: the polygon is degenerate; the message starts with ``what`` and names the vertex.
    """
    polygon = read_only(values)
    fault = polygon_fault(polygon, solid)
    if fault is None:
        return polygon
    where = "" if fault.vertex is None else f" (vertex {fault.vertex})"
    raise SceneError(f"{what} {fault.message}{where}")


def read_only(values: npt.ArrayLike) -> FloatArray:
    """A float64 copy that cannot be written to.

    Raises:
        SceneError: the values are not an array of numbers.
    """
    array = numbers(values, "")
    array.setflags(write=False)
    return array
