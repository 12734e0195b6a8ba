# SPDX-License-Identifier: Apache-2.0
"""Options that say where runs are run: ``--jobs`` and ``--cluster``."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator

from ftcm_core.cli.output import note
from ftcm_core.cluster import Cluster
from ftcm_core.errors import FtcmError
from ftcm_core.parallel import Processes


def machine_options(sub: argparse.ArgumentParser) -> None:
    """Declare the options."""
    sub.add_argument("--jobs", type=int, metavar="N", help="number of processes; default: one per core")
    sub.add_argument(
        "--cluster", metavar="ADDRESS",
        help="run on the processes of a Dask cluster instead; its scheduler, e.g. tcp://host:8786",
    )  # fmt: skip


@contextlib.contextmanager
def chosen_machines(arguments: argparse.Namespace) -> Iterator[int | Processes | None]:
    """Give what the options say, as of :func:`~ftcm_core.parallel.processes_of`.

    Raises:
        FtcmError: ``--jobs`` is no number of processes, or the cluster cannot be had.
    """
    if arguments.jobs is not None and arguments.jobs < 1:
        raise FtcmError(f"--jobs {arguments.jobs}: expected at least 1")
    if arguments.cluster is None:
        yield arguments.jobs
        return
    if arguments.jobs is not None:
        raise FtcmError("--jobs: is of this machine, and --cluster is given too; give one of them")
    with Cluster(arguments.cluster) as cluster:
        count = cluster.count
        some = f"{count or 'no'} process{'' if count == 1 else 'es'}"
        note(f"cluster {arguments.cluster}: {some}; more may join at any time")
        yield cluster
