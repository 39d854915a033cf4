import numpy as np
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.segmentation.detection import Detection
from visualrhp.embodiment.segmentation.overlays import COLOURS, overlay
from visualrhp.embodiment.segmentation.scores import SeenObject


def test_outlines_are_drawn_and_what_is_missed_is_hatched() -> None:
    image = np.full((80, 120, 3), 50, np.uint8)
    found, missed = np.zeros((80, 120), bool), np.zeros((80, 120), bool)
    found[30:50, 20:40] = True
    missed[30:50, 80:100] = True
    square = shapely.box(0.0, 0.0, 0.1, 0.1)
    objects = [SeenObject(Kind.BOX, False, found, square), SeenObject(Kind.CUP, False, missed, square)]
    picture = overlay(image, [Detection(Kind.BOX, False, found)], objects)
    assert (image == 50).all()
    assert picture[30, 30].tolist() == list(COLOURS[Kind.BOX]) and picture[40, 30].tolist() == [50, 50, 50]
    assert (picture[missed] == (255, 0, 0)).all(axis=1).mean() == 0.25
    assert (overlay(image, []) == 50).all()


def test_every_kind_has_a_colour() -> None:
    assert set(COLOURS) == set(Kind)
