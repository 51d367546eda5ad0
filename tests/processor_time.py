"""Run a command and print its wall time and the processor time of all processes, servers that outlive a test too.

``time`` counts a process only where its parent waits for it; a PostgreSQL that ``pg_ctl`` starts has none who does.
"""

import ctypes
import os
import resource
import signal
import subprocess
import sys
import time

_PR_SET_CHILD_SUBREAPER = 36


def main() -> None:
    """Run the command of the arguments and end with its exit code."""
    if sys.platform == "linux":
        # processes whose parent has ended become ours
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    began = time.monotonic()
    command = subprocess.Popen(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command has it too and ends
    signal.signal(signal.SIGTERM, lambda number, _: command.send_signal(number))
    pid, status = os.wait()
    while pid != command.pid:
        pid, status = os.wait()
    code = os.waitstatus_to_exitcode(status)
    wall_s = time.monotonic() - began
    while _is_another_over():
        pass
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor_s = used.ru_utime + used.ru_stime
    print(f"wall time {wall_s:.0f} s, processor time of all processes {processor_s:.0f} s", flush=True)
    sys.exit(code if code >= 0 else 128 - code)


def _is_another_over() -> bool:
    """Return whether a further process has ended, and count it."""
    try:
        return os.waitpid(-1, os.WNOHANG)[0] != 0
    except ChildProcessError:
        return False


if __name__ == "__main__":
    main()
