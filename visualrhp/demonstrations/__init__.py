"""Demonstrations of the kinodynamic RRT (Sec. 6.1): generation, storage, reading, replay and export."""
