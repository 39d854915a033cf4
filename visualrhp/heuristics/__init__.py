"""Heuristics that guide a planner: a policy to sample actions from, and the value beyond the horizon (Sec. 5.2)."""
