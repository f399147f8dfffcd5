"""Run a grid on a Ray cluster, with the same results as on one machine.

The nodes need this package at the same version. The folder of a run is on its node, under the same
path as here. If the nodes share a file system, a run whose node was lost resumes from its
checkpoint on another node; otherwise it restarts. Results are sent back and written here.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from saver_advisors.experiments import worker
from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.scheduler import LOOK_EVERY, RUNNING, Look, Places, Progress
from saver_advisors.reporting.provenance import command_line, write_json_atomic
from saver_advisors.training.stopping import Stop


class RayCluster:
    """Execute runs as tasks of a Ray cluster.

    :param places: folders of runs and results
    :param address: of the cluster, as for ``ray.init``, such as ``auto`` or ``ray://head:10001``
    :param threads: per run, one processor each
    :param retries: how often a run is repeated after its node was lost
    :raises ImportError: if Ray is not installed
    :raises ConnectionError: if no cluster answers at the address
    """

    def __init__(self, places: Places, address: str, threads: int = 1, retries: int = 3) -> None:
        try:
            import ray
        except ImportError as error:
            raise ImportError("a cluster needs Ray: pip install 'saver-envs[cluster]'") from error
        self.places = places
        self._ray = ray
        ray.init(address=address, ignore_reinit_error=True, log_to_driver=False)
        self._threads = threads
        self._do = ray.remote(num_cpus=threads, max_retries=retries)(run_on_node)

    @property
    def at_once(self) -> int:
        """How many runs the cluster's processors have room for at present."""
        processors = self._ray.cluster_resources().get("CPU", 1)
        return max(1, int(processors) // self._threads)

    def work(self, runs: list[ExperimentRun], progress: Progress, stop: Stop, look: Look) -> None:
        """Submit all runs to the cluster; cancel them on a request to stop."""
        output = str(self.places.output.resolve())
        pending: dict[Any, ExperimentRun] = {}
        for run in runs:
            task = self._do.remote(run.to_mapping(), output, command_line(), self._threads)
            pending[task] = run
            progress.words[run.name] = RUNNING
        cancelled = False
        while pending:
            if stop and not cancelled:
                for task in pending:
                    self._ray.cancel(task)
                cancelled = True
            ended, _ = self._ray.wait(list(pending), timeout=LOOK_EVERY)
            for task in ended:
                self._take(task, pending.pop(task), progress)
            look(progress)

    def _take(self, task: Any, run: ExperimentRun, progress: Progress) -> None:
        """Write the result of a task, or record why there is none."""
        try:
            status, words, result = self._ray.get(task)
        except (self._ray.exceptions.TaskCancelledError, KeyboardInterrupt):
            progress.end(run.name, worker.STOPPED, "")
            return
        except self._ray.exceptions.RayError as error:
            progress.end(run.name, worker.FAILED, str(error).splitlines()[-1])
            return
        if result is not None:
            write_json_atomic(self.places.result(run), result)
        progress.end(run.name, status, words)


@contextmanager
def local_cluster(nodes: int) -> Iterator[str]:
    """Start a Ray cluster on this machine.

    :param nodes: number of nodes, with a processor each
    :return: a context with the cluster's address, at whose end the cluster stops
    :raises ImportError: if Ray is not installed
    """
    # Ray reads it when it is imported.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    try:
        for _ in range(nodes - 1):
            cluster.add_node(num_cpus=1)
        yield str(cluster.address)
    finally:
        ray.shutdown()
        cluster.shutdown()


def run_on_node(
    values: dict[str, Any], output: str, command: str, threads: int = 1
) -> tuple[int, str, dict[str, Any] | None]:
    """Execute a run in its own process on the node that this is called on.

    :param values: the run, as a mapping
    :param output: the folder of run folders
    :param command: that results record as their origin
    :param threads: of the run
    :return: exit status, last line of the log, and the result or None
    """
    run = ExperimentRun.from_mapping(values)
    folder = Path(output) / run.name
    result = folder / "result" / f"{run.name}.json"
    result.parent.mkdir(parents=True, exist_ok=True)
    process = worker.start(run, folder, result, command, threads)
    try:
        while process.poll() is None:
            time.sleep(LOOK_EVERY)
    except KeyboardInterrupt:  # Ray cancels a task like this
        process.terminate()
        process.wait()
        raise
    content = json.loads(result.read_text(encoding="utf-8")) if result.is_file() else None
    return int(process.returncode), worker.last_words(folder), content
