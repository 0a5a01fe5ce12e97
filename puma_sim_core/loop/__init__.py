# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Closing the loop with measured data: from a residual to the effect that the model lacks.

``explain(logs, ...)`` gives an `Explanation`; the command is ``puma-sim explain``.
"""

from .explain import explain
from .result import Explanation

__all__ = ["Explanation", "explain"]
