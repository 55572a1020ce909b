"""Runs side by side: found and read, grouped by what differs, compared with their uncertainty, put into words.

runs.py          every run below some folders, each read back
groups.py        runs that differ in their seed alone
problems.py      what is missing, corrupt or duplicated
measures.py      what is compared
statistics.py    interquartile means, intervals, probability of improvement
findings.py      all of this for some folders, with pairs of groups compared
text.py, document.py    Markdown, JSON, CSV, and the folder of a report
curve_figures.py, comparison_figures.py    its figures
log_stats.py, log_stats_figure.py    the episodes of one log
"""
