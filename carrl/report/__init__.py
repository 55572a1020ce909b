"""Runs side by side: found and read, grouped by what differs, compared with their uncertainty, put into words.

reading.py, summary_file.py    one run's folder
runs.py          every run below some folders, with a name each
choices.py       what a run was asked to be
sweeps.py        what a multirun was to train
groups.py        runs that differ in their seed alone
problems.py      what is missing, broken, or there twice
measures.py      what is compared
statistics.py    interquartile means, intervals, probability of improvement
comparison.py    pairs of groups
curves.py        learning curves and profiles of a group
findings.py      all of this for some folders
runs_table.py    every run, and how far it is from the best possible lap
text.py, tables.py, document.py    Markdown, CSV and JSON
"""
