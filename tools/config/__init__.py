"""Scenarios: YAML files read, checked and resolved into what each process of a run is told.

`loader.load_scenario(path)` gives a `scenario.Resolved`, or raises ConfigError with every problem found. Nothing is imported
here: who reads a log needs two of these modules, not all.
"""
