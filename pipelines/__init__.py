"""The pipelines of the project, one Hydra application each: compose, build, call, write.

Run them from the root of the repository as ``python -m pipelines.<name> key=value ...``.
"""
