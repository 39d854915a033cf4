"""Measurements of speed, for people: ``make bench``."""
