# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The PUMA 560's first three joints with their motors, simulated; no ROS in this package.

The names of `__all__` are the public interface. Each is imported when it is first used, so that
importing the package costs neither NumPy nor a compiler::

    import puma_sim_core as ps

    plant = ps.Plant.of("bejczy", [ps.parse_effect("coulomb_friction:joint=2,torque=12")])
    explanation = ps.explain("log.csv")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from puma_sim_core.arm.arm import ArmParameters as ArmParameters
    from puma_sim_core.arm.parameters import load_parameters as load_parameters
    from puma_sim_core.arm.parameters import parameter_sets as parameter_sets
    from puma_sim_core.control.controllers import make_controller as make_controller
    from puma_sim_core.dynamics.pid import Pid as Pid
    from puma_sim_core.dynamics.pid import PidGains as PidGains
    from puma_sim_core.dynamics.servo import ServoConfig as ServoConfig
    from puma_sim_core.effects import Effect as Effect
    from puma_sim_core.effects import load_effects as load_effects
    from puma_sim_core.effects import parse_effect as parse_effect
    from puma_sim_core.errors import BagError as BagError
    from puma_sim_core.errors import CommandError as CommandError
    from puma_sim_core.errors import LimitError as LimitError
    from puma_sim_core.errors import ModelError as ModelError
    from puma_sim_core.errors import NonFiniteStateError as NonFiniteStateError
    from puma_sim_core.errors import ParameterError as ParameterError
    from puma_sim_core.errors import PumaSimError as PumaSimError
    from puma_sim_core.errors import RecordingError as RecordingError
    from puma_sim_core.errors import TuningError as TuningError
    from puma_sim_core.identify.data.ingest import read_log as read_log
    from puma_sim_core.identify.data.log import Log as Log
    from puma_sim_core.identify.explain import explain as explain
    from puma_sim_core.identify.report.output import write_explanation as write_explanation
    from puma_sim_core.identify.result import Detectable as Detectable
    from puma_sim_core.identify.result import Explanation as Explanation
    from puma_sim_core.identify.result import Fault as Fault
    from puma_sim_core.identify.result import Hypothesis as Hypothesis
    from puma_sim_core.identify.result import NamedEffect as NamedEffect
    from puma_sim_core.identify.result import Shape as Shape
    from puma_sim_core.plant.mechanism import Mechanism as Mechanism
    from puma_sim_core.plant.mechanism_file import load_mechanism as load_mechanism
    from puma_sim_core.plant.mechanism_file import mechanism_names as mechanism_names
    from puma_sim_core.plant.model_file import dump_model as dump_model
    from puma_sim_core.plant.model_file import load_model as load_model
    from puma_sim_core.plant.plant import Plant as Plant
    from puma_sim_core.recording.bag.reader import read_bag as read_bag
    from puma_sim_core.recording.bag.recover import recover as recover
    from puma_sim_core.recording.recording import Recording as Recording
    from puma_sim_core.recording.recording import read_csv as read_csv
    from puma_sim_core.recording.recording import write_csv as write_csv
    from puma_sim_core.simulation.batch import BatchResult as BatchResult
    from puma_sim_core.simulation.batch import run_batch as run_batch
    from puma_sim_core.simulation.replay import Replay as Replay
    from puma_sim_core.simulation.replay import replay as replay
    from puma_sim_core.simulation.session import Session as Session
    from puma_sim_core.simulation.session import SessionConfig as SessionConfig
    from puma_sim_core.simulation.simulator import Constraint as Constraint
    from puma_sim_core.simulation.simulator import Limits as Limits
    from puma_sim_core.simulation.simulator import Simulator as Simulator
    from puma_sim_core.tuning.controller_log import ControllerLog as ControllerLog
    from puma_sim_core.tuning.controller_log import read_controller_log as read_controller_log
    from puma_sim_core.tuning.pid_identification import PidEstimate as PidEstimate
    from puma_sim_core.tuning.pid_identification import identify_pid as identify_pid
    from puma_sim_core.tuning.ziegler_nichols import Loop as TuningLoop  # noqa: F401
    from puma_sim_core.tuning.ziegler_nichols import Ultimate as Ultimate
    from puma_sim_core.tuning.ziegler_nichols import settings as ziegler_nichols_settings  # noqa: F401
    from puma_sim_core.tuning.ziegler_nichols import ultimate_by_eigenvalues as ultimate_by_eigenvalues
    from puma_sim_core.tuning.ziegler_nichols import ultimate_by_simulation as ultimate_by_simulation

__version__ = "0.1.0"

#: module -> its public names; "name:other" makes `name` public as `other`
_PUBLIC = {
    "plant.plant": "Plant",
    "plant.model_file": "load_model dump_model",
    "plant.mechanism": "Mechanism",
    "plant.mechanism_file": "load_mechanism mechanism_names",
    "arm.arm": "ArmParameters",
    "arm.parameters": "load_parameters parameter_sets",
    "effects": "Effect load_effects parse_effect",
    "simulation.simulator": "Constraint Limits Simulator",
    "simulation.session": "Session SessionConfig",
    "simulation.batch": "BatchResult run_batch",
    "simulation.replay": "Replay replay",
    "recording.recording": "Recording read_csv write_csv",
    "recording.bag.reader": "read_bag",
    "recording.bag.recover": "recover",
    "identify.data.log": "Log",
    "identify.data.ingest": "read_log",
    "identify.explain": "explain",
    "identify.result": "Explanation NamedEffect Hypothesis Fault Shape Detectable",
    "identify.report.output": "write_explanation",
    "dynamics.pid": "Pid PidGains",
    "dynamics.servo": "ServoConfig",
    "control.controllers": "make_controller",
    "tuning.ziegler_nichols": "Loop:TuningLoop Ultimate "
    "settings:ziegler_nichols_settings ultimate_by_eigenvalues ultimate_by_simulation",
    "tuning.pid_identification": "PidEstimate identify_pid",
    "tuning.controller_log": "ControllerLog read_controller_log",
    "errors": "PumaSimError ParameterError ModelError RecordingError "
    "CommandError LimitError TuningError BagError NonFiniteStateError",
}
_SOURCES = {
    public or name: (module, name)
    for module, text in _PUBLIC.items()
    for name, _, public in (entry.partition(":") for entry in text.split())
}

__all__ = list(_SOURCES)


def __getattr__(name: str) -> object:
    """Import a public name at its first use."""
    if name not in _SOURCES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module, original = _SOURCES[name]
    value = getattr(import_module(f"{__name__}.{module}"), original)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names alone."""
    return sorted(__all__)
