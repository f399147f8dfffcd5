"""Grids of training runs: read from a file, run on this machine or on a cluster, and resumed."""

from saver_advisors.experiments.grid import ExperimentRun, Grid, read_grid
from saver_advisors.experiments.results import RunState, state_of

__all__ = ["ExperimentRun", "Grid", "RunState", "read_grid", "state_of"]
