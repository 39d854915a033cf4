"""How a heuristic is learned (Sec. 6): demonstrations, imitation, reinforcement learning, and their checkpoints."""
