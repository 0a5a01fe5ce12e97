# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller over topics that fails its trials in one way after the other; the file of its argument counts them."""

import os
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

import rclpy
from appraised import Appraised
from std_msgs.msg import Float64MultiArray

#: what it does in its trials
WAYS = ("well", "hangs", "well", "dies", "not finite", "floods", "two numbers", "well")
#: the state of a trial in which it does so
STATE = 10


class Misbehaving(Appraised):
    """The PID of the example, which misbehaves as `WAYS` says."""

    def __init__(self, counter: Path):
        super().__init__("voltage", 0)
        self.counter, self.way = counter, "well"

    def begin(self):
        super().begin()
        if self.trial.startswith("trial"):
            number = int(self.counter.read_text()) if self.counter.exists() else 0
            self.counter.write_text(str(number + 1))
            self.way = WAYS[number % len(WAYS)]
            self.law.update = self.misbehaving(self.law.update)

    def misbehaving(self, update):
        states = 0

        def instead(*state):
            nonlocal states
            states += 1
            volts = update(*state)
            if states != STATE:
                return volts
            while self.way == "hangs":
                time.sleep(1.0)
            if self.way == "dies":
                os.kill(os.getpid(), signal.SIGSEGV)
            for _ in range(3 * (self.way == "floods")):
                self.commands.publish(Float64MultiArray(data=volts))
            return {"not finite": [float("nan"), 0.0, 0.0], "two numbers": [0.0, 0.0]}.get(self.way, volts)

        return instead


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Misbehaving(Path(sys.argv[1])))
