"""Grids of training runs: read from a file, worked off on this machine or on a cluster, resumed."""

from saver_advisors.experiments.grid import ExperimentRun, Grid, read_grid
from saver_advisors.experiments.results import RunState, read_grid_results, state_of

__all__ = ["ExperimentRun", "Grid", "RunState", "read_grid", "read_grid_results", "state_of"]
