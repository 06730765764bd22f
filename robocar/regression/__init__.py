"""Keeping planners and estimators from getting worse: suites of runs, baselines, sweeps over many cores and machines, reports.

`suite` what to run · `pool` and `sweep` running it, with nothing lost · `results` what came out, as a table · `baseline` and
`compare` against what came out before · `divergence` where two runs part · `report` one page for people · `pytest_plugin`
all this in somebody's own tests. Nothing is imported here, so that the command line and pytest start fast.
"""
