"""The desired object, as a user names it: by its kind, and if there are several, by where it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.errors import PerceptionError
from visualrhp.parameters import Field, Index, parameters

if TYPE_CHECKING:  # schemas of configurations import this module, which is to be fast
    from visualrhp.embodiment.track import Track

_Metres = Annotated[float, Field(ge=-1.0, le=1.0)]
Place = tuple[_Metres, _Metres]
"""(x, y) on the table [m], world frame."""

_MISSED: Final = 0.03
"""Distance of a point from an object that it is meant to name, up to which it names it [m]."""


@parameters
class DesiredObject:
    """The object that the user names. It is chosen in the first views, and keeps its identity afterwards.

    Attributes:
        kind: what it is.
        which: of several, in the order of their distance from the base of the robot, the closest first; from 0.
        place: a point on it or close to it; only objects there are counted, in the order of their distance from it.
            None to name it without a place.
    """

    kind: Kind = Field(default=Kind.ORANGE, strict=False)
    which: Index = 0
    place: Place | None = None

    def choose(self, tracks: Sequence[Track], base: tuple[float, float]) -> Track:
        """The track that is meant.

        Args:
            tracks: what is seen.
            base: (x, y) of the robot's base [m].

        Raises:
            PerceptionError: none is.
        """
        candidates = [track for track in tracks if track.kind is self.kind]
        if self.place is not None:
            point = shapely.Point(self.place)
            candidates = [track for track in candidates if track.polygon.distance(point) <= _MISSED]
        origin = np.array(self.place or base)
        candidates.sort(key=lambda track: float(np.hypot(*(track.pose[:2] - origin))))
        if self.which < len(candidates):
            return candidates[self.which]
        where = "" if self.place is None else f" at ({self.place[0]:.3f}, {self.place[1]:.3f})"
        seen = [f"{t.kind} {t.id} at ({t.pose[0]:z.3f}, {t.pose[1]:z.3f})" for t in tracks]
        raise PerceptionError(
            f"the desired object, {self.kind} number {self.which}{where}, is not seen; seen are: "
            f"{', '.join(sorted(seen)) or 'nothing'}"
        )
