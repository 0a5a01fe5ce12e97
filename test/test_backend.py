# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The compiled and the interpreted kernel give the same bits; the cache is never in the way."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from puma_sim_core import jit as backend
from puma_sim_core.cli.output import start_at_once

needs_numba = pytest.mark.skipif(importlib.util.find_spec("numba") is None, reason="no numba")

#: plants, constraints and how they run, with every effect and stage of the kernel among them
PROGRAM = """
import json
import numpy as np
from puma_sim_core.jit import BACKEND
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.session import Session
from puma_sim_core.simulation.session import SessionConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

dry = ["coulomb_friction:joint=1,torque=12", "coulomb_friction:joint=2,torque=5",
       "asymmetric_coulomb_friction:joint=2,positive=8,negative=3",
       "asymmetric_coulomb_friction:joint=3,positive=7.1,negative=5.6"]
stribeck = [f"stribeck_friction:joint={j},torque=4,velocity=0.07" for j in (1, 2, 3)]
bristle = [f"presliding_friction:joint={j},torque=3" for j in (1, 3)]
rest = ["viscous_friction:joint=2,coefficient=9.5", "voltage_saturation:joint=1,voltage=9",
        "current_limit:joint=3,current=2", "soft_stop:joint=1,lower=-0.1,upper=0.15",
        "soft_stop:joint=2", "payload:mass=1.3,x=0.02"]
library = ["quadratic_friction:joint=1,coefficient=3", "torque_ripple:joint=3,amplitude=2,order=1",
           "load_dependent_friction:joint=2,coefficient=0.1", "joint_spring:joint=1,stiffness=9",
           "position_dependent_friction:joint=3,torque=3,amplitude=2,angle=0.5",
           "friction_warm_up:joint=2,share=0.5,time_constant=0.3", "supply_droop:coefficient=0.01",
           "resistance_drift:joint=1,share=0.3,time_constant=0.2", "base_tilt:x=0.04,y=-0.02",
           "impulse:joint=2,torque=60,time=0.2,width=0.05", "impulse_2:joint=2,torque=-30,time=0.4,width=0.04",
           "voltage_dead_band:joint=1,voltage=0.4",
           "voltage_offset:joint=2,voltage=0.3", "input_delay:time=0.0015",
           "sensor_lag:joint=1,time_constant=0.004", "encoder_offset:joint=2,angle=0.01",
           "sensor_nonlinearity:joint=3,amplitude=0.005,period=1.5"]
trains = ["joint_elasticity:joint=2,stiffness=2e4", "backlash:joint=3,gap=0.001",
          "transmission_error:joint=1,amplitude=5e-4,order=7"]
every = dry + stribeck + bristle + rest + library + trains
assert {KINDS[text.partition(":")[0]].first for text in every} == {kind.first for kind in KINDS.values()}
plants = {"none": [], "dry": dry, "dry and stribeck": dry + stribeck, "bristle": bristle,
          "rest": rest, "library": library, "all": every}
constraints = {"free": "free free free", "mixed": "free hold velocity:0.3",
               "accelerated": "acceleration:0.4 free free"}
time = np.arange(0.0, 0.6, 0.02)
volts = np.column_stack([12 * np.sin(9 * time), 14 * np.cos(7 * time), -9 * np.sin(11 * time)])
setpoint = np.array([0.05, -1.0, 0.8]) + 0.05 * np.sin(np.outer(np.arange(15), (0.5, 0.3, 0.7)))
result = {}

def add(name, *arrays):
    result[name] = [float(value).hex() for array in arrays for value in np.ravel(array)]

for plant_name, effects in plants.items():
    for form in ("physical", "printed"):
        plant = Plant.of("bejczy", map(parse_effect, effects), form)
        for name, kinds in constraints.items():
            simulator = Simulator(plant, constraints=list(map(Constraint.parse, kinds.split())))
            simulator.reset((0.0, -1.1, 0.9))
            run = simulator.run(time, volts, acceleration=True)
            add(f"{plant_name}, {form}, {name}", run.position, run.velocity, run.current,
                run.acceleration, simulator.bristles)
    simulator = Simulator(plant)
    simulator.reset((0.0, -1.0, 0.8))
    for servo in (ServoConfig(), ServoConfig(amplifier_gain=4.0, converter_bits=12,
                                             encoder_counts=1000, derivative_on_measurement=False)):
        run = simulator.run_servo(setpoint, servo)
        add(f"{plant_name}, servo {servo.converter_bits}", run.position, run.current, run.voltage)
    session = Session(SessionConfig(plant, "position", initial_position=(0.0, -1.0, 0.8)))
    for target in setpoint:
        session.command(target)
        state = session.step()
    add(f"{plant_name}, session", *state[2:])
print(json.dumps([BACKEND, result]))
"""


def python(program, **environment):
    changed = {**os.environ, **environment}
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env={k: v for k, v in changed.items() if v is not None},
    )


@pytest.mark.long
@needs_numba
def test_compiled_and_interpreted_kernels_give_the_same_bits():
    results = {}
    for kernel in ("numba", "python"):
        done = python(PROGRAM, PUMA_SIM_KERNEL=kernel)
        assert done.returncode == 0, done.stderr
        name, results[kernel] = json.loads(done.stdout)
        assert name == kernel
    assert results["numba"].keys() == results["python"].keys() and len(results["numba"]) > 50
    for name, numbers in results["numba"].items():
        assert numbers == results["python"][name], name


def test_the_environment_chooses_the_kernel():
    program = "from puma_sim_core.jit import BACKEND; print(BACKEND)"
    assert python(program, PUMA_SIM_KERNEL="python").stdout.strip() == "python"
    expected = "numba" if importlib.util.find_spec("numba") else "python"
    for choice in ("auto", None):
        assert python(program, PUMA_SIM_KERNEL=choice).stdout.strip() == expected


def test_an_unknown_kernel_is_an_error_that_says_what_there_is():
    done = python("import puma_sim_core.dynamics.rigid", PUMA_SIM_KERNEL="bogus")
    assert done.returncode != 0
    assert (
        "ParameterError: environment variable PUMA_SIM_KERNEL: kernel 'bogus'; expected auto, numba or python"
    ) in done.stderr


#: an environment without numba
HIDDEN = "import sys; sys.modules['numba'] = None; "


def test_without_numba_the_kernel_is_plain_python():
    done = python(
        HIDDEN + "from puma_sim_core.plant.plant import Plant; "
        "from puma_sim_core.simulation.simulator import Simulator; "
        "print(Simulator(Plant.of()).step((1, 2, 3))[6:], "
        "__import__('puma_sim_core.jit').jit.BACKEND)",
        PUMA_SIM_KERNEL="auto",
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("python")


def test_asking_for_numba_where_there_is_none_is_an_error():
    done = python(HIDDEN + "import puma_sim_core.jit", PUMA_SIM_KERNEL="numba")
    assert "numba is not installed; expected python or auto, or `pip install numba`" in done.stderr


def test_what_does_not_simulate_does_not_import_numba():
    program = (
        "import sys; import puma_sim_core, puma_sim_core.arm.parameters, "
        "puma_sim_core.arm.kinematics, puma_sim_core.arm.rigid_body, puma_sim_core.arm.third_order, "
        "puma_sim_core.recording.recording, puma_sim_core.recording.bag; "
        "from puma_sim_core.arm.parameters import load_parameters; load_parameters('bejczy'); "
        "print([name for name in sys.modules if name.partition('.')[0] in "
        "('numba', 'llvmlite', 'scipy', 'rclpy')])"
    )
    done = python(program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


# ----------------------------------------------------------------------------------------- cache


@pytest.fixture
def copied_package(tmp_path, monkeypatch):
    """A copy of the package, and the name of the cache that it would use as it is now."""
    copy = tmp_path / "puma_sim_core"
    shutil.copytree(Path(backend.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    spec = importlib.util.spec_from_file_location("jit_of_the_copy", copy / "jit.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return copy, lambda: Path(module.cache_directory()).name


def change(path):
    with open(path, "a", encoding="utf-8") as file:
        file.write("\n# changed\n")


def test_a_change_of_any_compiled_source_is_another_cache(copied_package):
    copy, cache_name = copied_package
    names = [cache_name()]
    for path in (
        "dynamics/rigid.py",
        "dynamics/contact.py",
        "dynamics/runs.py",
        "dynamics/lanes/registers.py",
        "jit.py",
        "effects/coulomb_friction.py",
        "effects/base.py",
        "servo/pid.py",
        "servo/servo.py",
    ):
        change(copy / path)
        names.append(cache_name())
    (copy / "effects" / "new_effect.py").write_text("EFFECT = None\n")
    names.append(cache_name())
    assert len(set(names)) == len(names)
    change(copy / "simulation" / "session.py")
    assert cache_name() == names[-1]


def test_a_change_of_any_module_whose_code_others_compile_is_another_cache(copied_package):
    # numba itself notices a change in the file of an entry point
    copy, cache_name = copied_package
    for path in copy.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        # an experiment of the thesis compiles its own slope, in the file of its entry points
        if path.parent.name != "thesis" and ("\n@inlined\n" in text or "\n@outlined\n" in text):
            before = cache_name()
            change(path)
            assert cache_name() != before, path


def test_a_copy_of_the_package_has_a_cache_of_its_own(copied_package):
    """numba keeps code by the path of its source: what one installation has compiled is not there for another."""
    _, cache_name = copied_package
    assert cache_name() != Path(backend.cache_directory()).name


def test_the_cache_is_in_the_users_cache_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = Path(backend.cache_directory())
    assert folder.parent == tmp_path / "puma_sim" and folder.name.startswith("kernel-")
    assert folder.is_dir() and not list(folder.iterdir())
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    assert backend.cache_directory().startswith(str(tmp_path / "own"))


def test_without_a_folder_to_write_there_is_no_cache(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "below"))
    assert backend.cache_directory() is None
    monkeypatch.delenv("XDG_CACHE_HOME")

    def homeless(path):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(backend.Path, "expanduser", homeless)
    assert backend.cache_directory() is None


@pytest.mark.long
@needs_numba
@pytest.mark.parametrize(("trials", "parts"), [(True, ["arm", "trains", "trials"]), (False, list(backend.PARTS))])
def test_what_a_command_needs_is_compiled_ahead_and_no_more(trials, parts, tmp_path, monkeypatch):
    """An appraisal needs single samples, and nothing of what `explain` runs."""
    started = []
    monkeypatch.setenv("PUMA_SIM_KERNEL", "auto")
    monkeypatch.setattr(backend, "BACKEND", "numba")
    monkeypatch.setattr(backend, "compiled_mark", lambda part: tmp_path / part)
    monkeypatch.setattr(backend, "await_compiled", lambda *_: None)
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: started.append(words))
    start_at_once(patient=True, trials=trials)
    (words,) = started
    assert words[-len(parts) :] == parts
    assert words[-len(parts) - 1] == "--locked"


def test_a_kernel_without_a_cache_compiles_and_runs(tmp_path):
    # a path below a file cannot be made, by no user whatever
    (tmp_path / "file").write_text("")
    done = python(
        "from puma_sim_core.dynamics.runs import terminal_voltages; "
        "from puma_sim_core.plant.plant import Plant; "
        "from puma_sim_core.jit import cache_directory; "
        "from puma_sim_core.simulation.run_inputs import native; "
        "table = native(Plant.of().constants.table); "
        "print(cache_directory(), terminal_voltages(1.0, 2.0, 3.0, table))",
        PUMA_SIM_KERNEL="numba",
        NUMBA_CACHE_DIR=None,
        XDG_CACHE_HOME=str(tmp_path / "file" / "below"),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "None (1.0, 2.0, 3.0)"


@pytest.mark.long
@needs_numba
def test_the_folder_of_other_users_of_numba_is_left_as_it_was(tmp_path):
    done = python(
        "import numba; before = numba.config.CACHE_DIR; import puma_sim_core.dynamics.runs; "
        "print(numba.config.CACHE_DIR == before)",
        PUMA_SIM_KERNEL="numba",
        XDG_CACHE_HOME=str(tmp_path),
    )
    assert done.stdout.strip() == "True", done.stderr
