# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Entry point of ``sim_node``.

``--effects FILE``, as often as needed and before ``--ros-args``, registers effects of the user's own; the node, and
with it the kernel that is built from all registered effects, is imported after that.
"""

import signal
import sys


def main(args: list[str] | None = None) -> int:
    """Run the node; returns the exit status."""
    # a signal ends it at once while the rest is imported, too: nothing is open yet. A handler of Python's would run
    # when a library is loaded, which takes the better part of a second and on a busy machine several
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    import argparse

    from puma_sim_core.effects import load_effects
    from puma_sim_core.errors import PumaSimError

    own = list(sys.argv[1:] if args is None else args)
    options = argparse.ArgumentParser(prog="sim_node", add_help=False, allow_abbrev=False)
    options.add_argument("--effects", action="append", default=[])
    try:
        files, _ = options.parse_known_args(own[: own.index("--ros-args")] if "--ros-args" in own else own)
        load_effects(files.effects)
    except PumaSimError as error:
        print(f"sim_node: {error}", file=sys.stderr)
        return 2
    from puma_sim_ros.node.run import main as run  # the kernel is built from the effects known by then

    return run(args)


if __name__ == "__main__":
    sys.exit(main())
