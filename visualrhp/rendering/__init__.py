"""Rendering for people: frames of a scene, imagined roll-outs, videos, a window."""
