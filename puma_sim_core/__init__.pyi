# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The public names and where they stand; the package imports each at its first use."""

from puma_sim_core.arm.arm import ArmParameters as ArmParameters
from puma_sim_core.arm.parameters import load_parameters as load_parameters
from puma_sim_core.arm.parameters import parameter_sets as parameter_sets
from puma_sim_core.control.controllers import make_controller as make_controller
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
from puma_sim_core.servo.pid import Pid as Pid
from puma_sim_core.servo.pid import PidGains as PidGains
from puma_sim_core.servo.servo import ServoConfig as ServoConfig
from puma_sim_core.simulation.batch import BatchResult as BatchResult
from puma_sim_core.simulation.batch import InitialState as InitialState
from puma_sim_core.simulation.batch import run_batch as run_batch
from puma_sim_core.simulation.conditions import Constraint as Constraint
from puma_sim_core.simulation.conditions import Limits as Limits
from puma_sim_core.simulation.replay import Replay as Replay
from puma_sim_core.simulation.replay import replay as replay
from puma_sim_core.simulation.session import Session as Session
from puma_sim_core.simulation.session_config import SessionConfig as SessionConfig
from puma_sim_core.simulation.simulator import Simulator as Simulator
from puma_sim_core.tuning.controller_log import ControllerLog as ControllerLog
from puma_sim_core.tuning.controller_log import read_controller_log as read_controller_log
from puma_sim_core.tuning.pid_identification import PidEstimate as PidEstimate
from puma_sim_core.tuning.pid_identification import identify_pid as identify_pid
from puma_sim_core.tuning.ziegler_nichols import Loop as TuningLoop
from puma_sim_core.tuning.ziegler_nichols import Ultimate as Ultimate
from puma_sim_core.tuning.ziegler_nichols import settings as ziegler_nichols_settings
from puma_sim_core.tuning.ziegler_nichols import ultimate_by_eigenvalues as ultimate_by_eigenvalues
from puma_sim_core.tuning.ziegler_nichols import ultimate_by_simulation as ultimate_by_simulation

__version__: str
__all__: list[str]
