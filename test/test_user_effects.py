# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A user's own effects from outside the package: simulated, recorded and replayed, explained, run by the node."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
COGGING = ROOT / "examples" / "effects" / "motor_cogging.py"
HYSTERESIS = ROOT / "examples" / "effects" / "gear_hysteresis.py"


#: a kernel that is compiled with an effect of its own takes half a minute the first time; what has the same files of
#: effects shares it
KERNELS = pytest.mark.parametrize("kernel", ["python", pytest.param("auto", marks=pytest.mark.long)])


def command(*arguments, kernel: str | None = None, cwd=None) -> subprocess.CompletedProcess:
    """`puma-sim` in a process of its own: the kernel is built once in each."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **({"PUMA_SIM_KERNEL": kernel} if kernel else {})}
    environment.pop("PUMA_SIM_EFFECTS", None)
    return subprocess.run(
        [sys.executable, "-m", "puma_sim_core", *map(str, arguments)],
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
    )


def python(program: str, **environment: str) -> list:
    """What a program prints as JSON, in a process of its own."""
    own = {key: value for key, value in os.environ.items() if key != "PUMA_SIM_EFFECTS"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**own, "PYTHONPATH": str(ROOT), **environment},
        cwd="/",  # what is imported is what PYTHONPATH says
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def volts_file(path: Path, seconds: float = 1.0) -> Path:
    """Voltages that move all joints."""
    time = np.arange(0.0, seconds, 0.01)
    volts = np.column_stack([9 * np.sin(2 * time), 12 * np.cos(3 * time) - 3, 7 * np.sin(4 * time) - 1])
    rows = np.column_stack([time, volts])
    np.savetxt(path, rows, delimiter=",", header="time,voltage1,voltage2,voltage3", comments="", fmt="%.6f")
    return path


#: accelerations at the start with an effect less those without, times the inertia, are its torques
LAW = f"""
import json
import numpy as np
from puma_sim_core.effects import load_effects, parse_effect
load_effects([{str(COGGING)!r}, {str(HYSTERESIS)!r}])
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

found = []
for q3 in np.linspace(0.9, 1.1, 9):
    first = []
    for effects in ([], ["motor_cogging:joint=3,amplitude=1.5,order=4,phase=0.3"]):
        plant = Plant.of("bejczy", map(parse_effect, effects))
        simulator = Simulator(plant)
        simulator.reset((0.2, -1.2, q3))
        first.append(simulator.run([0.0, 0.01], np.zeros((2, 3)), acceleration=True).acceleration[0])
    whole = inertia(np.array([0.2, -1.2, q3]), plant.arm) + np.diag([m.inertia for m in plant.arm.motors])
    found.append([q3, float(plant.arm.motors[2].gear_ratio), *(whole @ (first[0] - first[1])).tolist()])
print(json.dumps(found))
"""


@KERNELS
def test_the_law_of_a_user_acts_on_its_joint(kernel):
    for q3, gear, *torque in python(LAW, PUMA_SIM_KERNEL=kernel):
        x = 4.0 * gear * q3 + 0.3
        assert np.allclose(torque, [0.0, 0.0, 1.5 * (np.sin(x) + 0.5 * np.sin(2.0 * x))], atol=1e-9)


#: a joint that is moved to and fro at a constant speed against the hysteresis, and what its motor's current bears
LOOP = f"""
import json
import numpy as np
from puma_sim_core.effects import load_effects, parse_effect
load_effects([{str(COGGING)!r}, {str(HYSTERESIS)!r}])
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

plant = Plant.of("bejczy", [parse_effect("gear_hysteresis:joint=1,torque=8,travel=0.02")])
simulator = Simulator(plant, max_step=1e-3)
simulator.reset((0.0, -1.2, 1.0))
time = np.arange(0.0, 1.5, 0.005)
volts = np.zeros((len(time), 3))
volts[:, 0] = 6.0 * np.sin(5.0 * time)
run = simulator.run(time, volts)
print(json.dumps([run.position[:, 0].tolist(), simulator.further[0], simulator.whole.z[9]]))
"""


@KERNELS
def test_a_state_of_its_own_follows_the_travel_and_is_carried_on(kernel):
    positions, further, in_state = python(LOOP, PUMA_SIM_KERNEL=kernel)
    deflection = 0.0
    for before, now in pairwise(positions):
        deflection = min(max(deflection + now - before, -0.02), 0.02)
    assert np.ptp(positions) > 0.06, "the joint goes past its corners"
    assert further == in_state == pytest.approx(deflection, abs=2e-4)


@pytest.mark.long
def test_both_kernels_and_reruns_give_the_same_bytes(tmp_path):
    volts, texts = volts_file(tmp_path / "volts.csv"), []
    # while a kernel is compiled behind it, `auto` would run as plain Python
    for kernel in ("python", "numba", "numba"):
        out = tmp_path / f"{len(texts)}.csv"
        done = command(
            *("simulate", volts, "--out", out, "--initial", "0,-1.2,1.0"),
            *("--effects", COGGING, "--effect", "motor_cogging:joint=3,amplitude=1.5,order=4"),
            *("--effects", HYSTERESIS, "--effect", "gear_hysteresis:joint=2,torque=8,travel=0.02"),
            *("--effect", "coulomb_friction:joint=2,torque=4"),
            kernel=kernel,
        )
        assert done.returncode == 0, done.stderr
        texts.append(out.read_bytes())
    plain = tmp_path / "plain.csv"
    assert command("simulate", volts, "--out", plain, "--initial", "0,-1.2,1.0").returncode == 0
    assert texts[0] == texts[1] == texts[2] != plain.read_bytes()


def test_an_effect_of_a_user_is_listed_and_goes_into_a_model_file(tmp_path):
    listed = command("list", "motor_cogging", "--effects", COGGING, kernel="python")
    assert listed.returncode == 0 and "sin(n N q + f)" in listed.stdout
    model = tmp_path / "model.yaml"
    effect = "motor_cogging:joint=3,amplitude=1.5,order=4"
    assert command("model", "--effects", COGGING, "--effect", effect, "--out", model, kernel="python").returncode == 0
    volts = volts_file(tmp_path / "volts.csv", 0.2)
    arguments = ("simulate", volts, "--model", model, "--out", tmp_path / "run.csv")
    assert command(*arguments, "--effects", COGGING, kernel="python").returncode == 0
    refused = command(*arguments, "--force", kernel="python")
    assert refused.returncode == 2 and "unknown effect 'motor_cogging'" in refused.stderr


@pytest.mark.parametrize(
    "text, message",
    [
        (None, "cannot be read; expected a Python file with EFFECT"),
        ("x = 1\n", "EFFECT is NoneType; expected EFFECT = Kind(...)"),
        ("import nothing_of_this_name\n", "ModuleNotFoundError"),
        ("def broken(:\n", "SyntaxError"),
        (COGGING.read_text().replace('name="motor_cogging"', 'name="backlash"'), "effect backlash is defined twice"),
        (COGGING.read_text().replace("acts=TORQUE,", "acts=TORQUE, per_joint=True, wrong=1,"), "TypeError"),
    ],
)
def test_a_file_without_a_usable_effect_is_named(tmp_path, text, message):
    file = tmp_path / "mine.py"
    if text is not None:
        file.write_text(text)
    done = command("list", "--effects", file, kernel="python")
    assert done.returncode == 2 and message in done.stderr and "Traceback" not in done.stderr
    assert done.stdout == ""


def test_effects_cannot_come_after_the_kernel():
    late = f"""
import json
from puma_sim_core.effects import load_effects
import puma_sim_core.simulation.simulator
from puma_sim_core.errors import ParameterError
try:
    load_effects([{str(COGGING)!r}])
except ParameterError as error:
    print(json.dumps(str(error)))
"""
    assert "before anything is simulated" in python(late)


def test_one_new_file_in_the_package_is_a_new_effect(tmp_path):
    """Adding an effect to the product: one file in effects/, and nothing else."""
    for name in ("puma_sim_core", "config"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(COGGING, tmp_path / "puma_sim_core" / "effects")
    program = """
import json
from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

kind = KINDS["motor_cogging"]
simulator = Simulator(Plant.of("bejczy", [parse_effect(kind.example)]))
simulator.run([0.0, 0.1], [[5.0, 5.0, 5.0]] * 2)
known = KINDS["torque_ripple"].told_from("motor_cogging")
print(json.dumps([kind.screening is not None, list(simulator.state), known]))
"""
    listed, state, known = python(program, PYTHONPATH=str(tmp_path), PUMA_SIM_KERNEL="python")
    assert listed and np.isfinite(state).all()
    assert known == "the waves are sines, without a second harmonic"


def test_an_entry_point_of_another_package_is_an_effect(tmp_path):
    (tmp_path / "cogging_package.py").write_text(COGGING.read_text())
    info = tmp_path / "cogging_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: cogging-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[puma_sim.effects]\nmotor_cogging = cogging_package:EFFECT\n")
    program = "import json; from puma_sim_core.effects import KINDS; print(json.dumps(list(KINDS)))"
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    assert "motor_cogging" in python(program, PYTHONPATH=path)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "effect, joint",
    [("motor_cogging:joint=3,amplitude=2.5,order=4,phase=1.0", 3), ("gear_hysteresis:joint=2,torque=9,travel=0.04", 2)],
)
def test_explain_names_an_effect_of_a_user(tmp_path, effect, joint):
    """The whole way: volts that move all joints, a run with the effect, its name from the log; both files are known, so
    that one is told from the other."""
    files = ("--effects", COGGING, "--effects", HYSTERESIS)
    name, log = effect.partition(":")[0], tmp_path / "log.csv"
    time = np.arange(0.0, 8.0, 0.005)
    tones = np.array([[0.9, 1.7, 3.1], [0.7, 1.5, 2.7], [0.8, 1.3, 2.3]])
    volts = sum(a * np.sin(np.outer(time, w) + a) for a, w in zip((7.0, 6.0, 5.0), tones.T, strict=True))
    volts += np.array([0.0, -8.0, -1.0])
    np.savetxt(
        tmp_path / "volts.csv",
        np.column_stack([time, volts]),
        delimiter=",",
        header="time,voltage1,voltage2,voltage3",
        comments="",
        fmt="%.5f",
    )
    run = tmp_path / "run.csv"
    done = command(
        *("simulate", tmp_path / "volts.csv", "--out", run, "--initial", "0,-1.5,1.2", "--limits", "off"),
        *("--effect", "viscous_friction:joint=1,coefficient=5", "--effect", "viscous_friction:joint=2,coefficient=9"),
        *("--effect", "viscous_friction:joint=3,coefficient=4", *files, "--effect", effect),
        # compiled here: `explain` would end a compilation behind it, and begin another one
        kernel="numba",
    )
    assert done.returncode == 0, done.stderr
    rows = np.genfromtxt(run, delimiter=",", names=True)
    measured = [np.round(rows[f"position{j}"] / 2e-5) * 2e-5 for j in (1, 2, 3)]
    columns = np.column_stack([time, volts, *measured])
    header = "time,voltage1,voltage2,voltage3,position1,position2,position3"
    np.savetxt(log, columns, delimiter=",", header=header, comments="", fmt="%.6f")
    done = command("explain", log, *files, "--out", tmp_path / "report")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert [(found["name"], found["joint"]) for found in report["effects"]][:1] == [(name, joint)]
