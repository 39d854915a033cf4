"""Evaluation of planners: the table of episodes, metrics with intervals, summaries, figures, videos, the report.

Import from the modules: those for figures and for the report's page import matplotlib and Jinja, the others do not.
"""
