"""A robot cell in MuJoCo: another physics engine, in three dimensions, seen through its camera only."""
