"""VisualRHP: learning image-based receding horizon planning for manipulation in clutter."""

__version__ = "0.1.0"
