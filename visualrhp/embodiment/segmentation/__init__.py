"""Instance segmentation of the camera's image: which objects there are, of what kind, and where (paper, Sec. 5.1)."""

from visualrhp.embodiment.segmentation.detection import Detection, Segmenter

__all__ = ["Detection", "Segmenter"]
