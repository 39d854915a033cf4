"""The execution phase: camera, planner and arm in a closed loop (paper, Sec. 3 and 5)."""
