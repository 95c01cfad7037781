"""Loaded by worker processes of this machine: Ctrl-C is for the command that began them, which ends them."""

import signal


def dask_setup(_worker: object) -> None:
    """Called in a worker process that begins."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
