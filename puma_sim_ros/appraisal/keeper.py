# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Runs a command, and ends all of its process group when its own standard input ends, as it does when the process that
has started it ends in whatever way. A file by itself: it is run without the package."""

import os
import signal
import subprocess
import sys
import threading


def _end_with_the_starter() -> None:
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """Run ``sys.argv[1:]``; returns its status, 128 more than the number of a signal."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # ended by these is the command; what is inherited must not be deafness
        signal.signal(number, lambda *_: None)
    threading.Thread(target=_end_with_the_starter, daemon=True).start()
    try:
        status = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL).wait()
    except OSError as error:
        print(f"{sys.argv[1]}: {error.strerror}", file=sys.stderr)
        return 127
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    # the thread waits for its input for ever
    os._exit(code)
