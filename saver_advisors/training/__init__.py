"""Training runs: settings, start, checkpoint, resume, release."""

from saver_advisors.training.building import ALGORITHMS, build_advisor, build_env, build_model
from saver_advisors.training.launch import load_trained, open_run, train
from saver_advisors.training.run import RunResult
from saver_advisors.training.settings import AdviceConfig, RunConfig

__all__ = [
    "ALGORITHMS",
    "AdviceConfig",
    "RunConfig",
    "RunResult",
    "build_advisor",
    "build_env",
    "build_model",
    "load_trained",
    "open_run",
    "train",
]
