"""`python -m mphygs.batch.child_process ...`: a command that ends with the process that began it.

Its arguments are the command's: of `mphygs`, or of the script whose file the environment names. Standard
input is the other end of a pipe that nothing is written to: once it is closed, by whatever ended the worker,
the command is interrupted as by Ctrl-C, and killed where it does not heed that.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading
import time

# Of the environment: the file of a script to run in place of the package.
SCRIPT = "MPHYGS_BATCH_SCRIPT"
# Seconds that an interrupted command has to leave its run folder in order.
GRACE = 10.0


def interrupt_when_closed(descriptor: int) -> None:
    """Interrupt this process once nobody holds the other end of a pipe."""
    while os.read(descriptor, 4096):
        pass
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(GRACE)
    os.kill(os.getpid(), signal.SIGKILL)


def main() -> None:
    """Run `mphygs`, or the script, with the arguments of this process."""
    # whoever began it may have been deaf to interrupts, as what runs in the background is
    signal.signal(signal.SIGINT, signal.default_int_handler)
    pipe = os.dup(0)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    threading.Thread(target=interrupt_when_closed, args=(pipe,), daemon=True).start()
    script = os.environ.pop(SCRIPT, "")
    if script:
        sys.path[0] = os.path.dirname(script)
        runpy.run_path(script, run_name="__main__")
    else:
        runpy.run_module("mphygs", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
