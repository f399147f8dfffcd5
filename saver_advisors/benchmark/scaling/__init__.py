"""How a grid scales with the nodes of a cluster, and what placing and resuming a run costs."""
