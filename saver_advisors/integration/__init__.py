"""The closed loop of chapter 8: a camera, a person, a policy and two arms, stage by stage.

A `graph.Graph` of `stage.LoopStage`s runs on the clock of a `bench.RobotBench`, each stage at its
rate and with its latency. See docs/integration.md.
"""

from typing import Final

POLICY: Final = "wrist-push"
"""The shipped policy that drives the loop by default."""
EXPERT: Final = "expert"
"""The scripted policy of an environment, to separate a loop's faults from a policy's."""
EXTRACTION: Final = "extraction"
"""The procedure in which care tasks are played in turn; see docs/care.md."""
