"""Learning of heuristics (Sec. 6): imitation and reinforcement learning, and their checkpoints."""
