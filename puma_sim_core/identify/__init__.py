# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Identification: from measured logs to the effect that the model lacks.

``explain(logs, ...)`` gives an `Explanation`; the command is ``puma-sim explain``.
"""

from puma_sim_core.identify.explain import explain
from puma_sim_core.identify.result import Explanation

__all__ = ["Explanation", "explain"]
