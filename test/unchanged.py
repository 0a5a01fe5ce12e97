# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Record what a change of structure must not change, and compare two recordings.

  python test/unchanged.py record --out DIR [--quick] [--only bags,reports,thesis,effects]
  python test/unchanged.py compare DIR1 DIR2 [--only ...] [--apart-from-prose]

The package that is recorded is the one of PYTHONPATH. PUMA_SIM_DATA names the folder of measured
logs, which the reports need. A recording has a folder for each part:

  effects/BACKEND/   each effect alone and in company, on both kernels: rows as raw float64, CSV
                     of the command line
  bags/              bags of sessions without ROS
  reports/           report.json and model.yaml of logs that were explained
  thesis/            the results of the thesis, one file an experiment

Each part has an index.json with the sha256 of its files. A recording made with --quick has some of
the files of a full one; the two can be compared. `compare` ends with 1 where a file differs.

With --apart-from-prose a text of several words may differ, apart from those that are results.

What was left out because it differs between two recordings of the same code: `seconds` of
report.json, which is time as measured. The results of the thesis are written without such times.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import yaml

PARTS = ("effects", "bags", "reports", "thesis")
BACKENDS = ("numba", "python")
RECORDS = Path(__file__).resolve().parent / "blind" / "records"
FIELDS = ("time", "voltage", "position", "velocity", "current", "acceleration", "setpoint")
START = (0.1, -1.1, 0.9)

#: where each name stands: the first module that has it counts
PLACES = {
    "KINDS": ("effects.registry", "effects"),
    "parse_effect": ("effects.registry", "effects"),
    "Plant": ("plant.plant", "plant"),
    "load_mechanism": ("plant.mechanism_file", "plant.mechanism", "mechanisms"),
    "load_parameters": ("arm.parameters", "parameters"),
    "Simulator": ("simulation.simulator", "simulator"),
    "run_batch": ("simulation.batch", "batch"),
    "Session": ("simulation.session", "session"),
    "SessionConfig": ("simulation.session", "session"),
    "ServoConfig": ("servo.servo", "dynamics.servo", "control.servo"),
    "BagRecorder": ("recording.bag", "bag"),
    "RecordedCommand": ("recording.bag", "bag"),
    "ParameterError": ("errors",),
    "PumaSimError": ("errors",),
    "yaml_text": ("files",),
}

#: value of a parameter that has no default, by (name, unit) or by unit
VALUES = {
    ("coefficient", "1"): 0.2,
    ("coefficient", "1/A"): 0.01,
    ("current", "A"): 5.0,
    ("gap", "rad"): 0.003,
    ("amplitude", "rad"): 0.003,
    ("period", "rad"): 0.5,
    ("time_constant", "s"): 0.05,
    ("time", "s"): 0.0035,
    ("width", "s"): 0.03,
    ("share", "1"): 0.4,
    ("transmitted", "1"): 0.5,
    ("order", "1"): 3.0,
    ("negative", "N.m"): 4.0,
    "N.m": 6.0,
    "N.m.s/rad": 5.0,
    "N.m.s2/rad2": 3.0,
    "N.m/rad": 2e4,
    "rad": 0.02,
    "V": 1.5,
    "s": 0.01,
    "kg": 2.0,
    "m": 0.1,
    "A": 5.0,
    "1": 0.3,
}

#: effects that act on each other
TOGETHER = {
    "dry_and_bristle": (
        "coulomb_friction:joint=1,torque=12",
        "coulomb_friction:joint=2,torque=9",
        "stribeck_friction:joint=2,torque=4",
        "presliding_friction:joint=2,torque=3",
        "asymmetric_coulomb_friction:joint=3,positive=5,negative=3",
        "presliding_friction:joint=3",
    ),
    "dry_of_every_kind": (
        "coulomb_friction:joint=2,torque=4",
        "asymmetric_coulomb_friction:joint=2,positive=3,negative=2",
        "stribeck_friction:joint=2,torque=4,sliding=1",
        "load_dependent_friction:joint=2,coefficient=0.1,transmitted=0.5",
        "position_dependent_friction:joint=2,torque=3,amplitude=2",
        "viscous_friction:joint=2,coefficient=9.5",
        "friction_warm_up:joint=2,share=0.5,time_constant=0.1",
    ),
    "two_masses_and_play": (
        "joint_elasticity:joint=1,stiffness=20000",
        "backlash:joint=2,gap=0.002",
        "backlash:joint=3,gap=0.001,stiffness=100000",
        "coulomb_friction:joint=2,torque=6",
        "transmission_error:joint=3,amplitude=0.0005,order=40",
    ),
    "delay_and_sensors": (
        "input_delay:time=0.0041",
        "sensor_lag:joint=2,time_constant=0.004",
        "encoder_offset:joint=1,angle=0.03",
        "sensor_nonlinearity:joint=3,amplitude=0.004,period=0.7,phase=0.4",
    ),
    "amplifiers": (
        "voltage_saturation:joint=1,voltage=20",
        "voltage_saturation:joint=2,voltage=30",
        "current_limit:joint=2,current=3",
        "voltage_dead_band:joint=3,voltage=2",
        "voltage_offset:joint=1,voltage=0.7",
        "input_delay:time=0.0041",
    ),
    "stop_and_blow": (
        "soft_stop:joint=1,lower=0.05,upper=0.12",
        "impulse:joint=2,torque=40,time=0.1,width=0.03",
        "base_tilt:x=0.05,y=-0.03",
        "payload:mass=1.1",
    ),
}


def core() -> SimpleNamespace:
    """The names of the package that this script uses, wherever they stand."""
    found = {}
    for name, modules in PLACES.items():
        reasons = []
        for module in modules:
            try:
                found[name] = getattr(importlib.import_module(f"puma_sim_core.{module}"), name)
                break
            except (ImportError, AttributeError) as reason:
                reasons.append(str(reason))
        else:
            raise ImportError(f"{name} stands in none of {', '.join(modules)}: {'; '.join(reasons)}")
    return SimpleNamespace(**found)


def checkout() -> Path:
    """The folder of PYTHONPATH with the package.

    Raises
    ------
    SystemExit : none has it, or another one is imported.
    """
    entries = [Path(entry).resolve() for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    named = [entry for entry in entries if (entry / "puma_sim_core" / "__init__.py").exists()]
    if not named:
        sys.exit("PYTHONPATH names no folder with puma_sim_core; it chooses what is recorded")
    import puma_sim_core

    used = Path(puma_sim_core.__file__).resolve().parent.parent
    if used != named[0]:
        sys.exit(f"PYTHONPATH names {named[0]}, but puma_sim_core of {used} is imported")
    return used


def say(text: str) -> None:
    print(text, flush=True)


def start(arguments: list[str], folder: Path, backend: str = "numba", shown: bool = False) -> None:
    """Run Python with arguments in a folder that has no package of its own.

    shown : let it write to the terminal as it goes.

    Raises
    ------
    SystemExit : it failed; names what it wrote.
    """
    entries = [str(Path(entry).resolve()) for entry in os.environ["PYTHONPATH"].split(os.pathsep) if entry]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entries), "PUMA_SIM_KERNEL": backend}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=not shown, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{' '.join(arguments)} ended with {done.returncode}\n{done.stdout or ''}{done.stderr or ''}")


def puma_sim(folder: Path, *arguments: object, backend: str = "numba") -> None:
    """`puma-sim` with arguments in a folder."""
    start(["-m", "puma_sim_core", *map(str, arguments)], folder, backend)


def write_index(folder: Path) -> None:
    """Write index.json of a part: the sha256 of each file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "index.json")
    index = {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    (folder / "index.json").write_text(json.dumps(index, indent=1, sort_keys=True) + "\n")


# ------------------------------------------------------------------------------------------ effects


def value_of(parameter) -> float:
    """A fixed value within the bounds, at which the effect acts: the default unless it is neutral."""
    if parameter.default is not None and parameter.default != parameter.neutral:
        return parameter.default
    value = VALUES.get((parameter.name, parameter.unit), VALUES.get(parameter.unit))
    if value is None:
        value = parameter.low + 0.01 * (min(parameter.high, parameter.low + 100.0) - parameter.low)
    return min(max(value, parameter.low), parameter.high)


def effect_text(kind, joint: int) -> str:
    """An effect as the command line has it; what the arm gives is left to the arm."""
    items = [f"joint={joint}"] if kind.per_joint else []
    items += [f"{p.name}={value_of(p)!r}" for p in kind.parameters if p.from_arm is None]
    return f"{kind.name}:{','.join(items)}"


def company(c: SimpleNamespace, joints: tuple[int, ...]) -> tuple[str, ...]:
    """Effects of all kinds on these joints, as many as can stand together."""
    texts: tuple[str, ...] = ()
    for kind in c.KINDS.values():
        for joint in joints if kind.per_joint else joints[:1]:
            more = (*texts, effect_text(kind, joint))
            try:
                c.Plant.of("bejczy", tuple(map(c.parse_effect, more)))
            except c.ParameterError:
                continue
            texts = more
    return texts


def cases(c: SimpleNamespace) -> dict[str, tuple[str, ...]]:
    """Effects by the name of their recording."""
    found: dict[str, tuple[str, ...]] = {"none": ()}
    for kind in c.KINDS.values():
        if kind.per_joint:
            for joint in (1, 2, 3):
                found[f"{kind.name}-{joint}"] = (effect_text(kind, joint),)
        else:
            found[kind.name] = (effect_text(kind, 1),)
    # a warm-up is one of viscous friction
    found["warm_up_of_viscous"] = tuple(
        effect_text(c.KINDS[name], 2) for name in ("viscous_friction", "friction_warm_up")
    )
    return {**found, **TOGETHER, "all-1": company(c, (1,)), "all-2": company(c, (2,)), "all": company(c, (1, 2, 3))}


def drive(rows: int, joints: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] that are not evenly spaced, and voltages [V] with reversals and large steps."""
    k = np.arange(rows)
    t = 0.004 * k + 0.0007 * (k % 3)
    columns = [
        (14.0 + 4.0 * j) * np.sin(2.0 * math.pi * (4.0 + j) * t + j) + 30.0 * ((k // 9 + j) % 4 == 3)
        for j in range(joints)
    ]
    return t, np.round(np.stack(columns, axis=1), 6)


def packed(recording) -> bytes:
    """All columns of a recording, one after the other, as float64."""
    found = (getattr(recording, name, None) for name in FIELDS)
    return b"".join(np.ascontiguousarray(each, dtype="<f8").tobytes() for each in found if each is not None)


def tried(make: Callable[[], bytes], error: type[Exception]) -> bytes:
    """What `make` gives, or the kind of its error and the row, which must not change either."""
    try:
        return make()
    except error as found:
        return f"{type(found).__name__} {getattr(found, 'step', '')}\n".encode()


def effect_runs(c: SimpleNamespace, texts: tuple[str, ...], rows: int) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of each way to run an arm with effects."""
    plant = c.Plant.of("bejczy", tuple(map(c.parse_effect, texts)))
    times, volts = drive(rows)
    chain = c.ServoConfig(converter_bits=12, encoder_counts=1000, delay_samples=1)
    targets = np.array(START) + 0.2 * np.sin(np.arange(rows // 10)[:, None] * (0.9, 0.7, 1.1))

    def simulator():
        made = c.Simulator(plant)
        made.reset(START, (0.3, -0.2, 0.0), (0.5, 0.0, -0.5))
        return made

    def switched():
        enable = np.ones((rows, 3))
        enable[rows // 2 :, 1] = 0
        return packed(simulator().run(times, volts, enable=enable))

    yield "run", tried(lambda: packed(simulator().run(times, volts, acceleration=True)), c.PumaSimError)
    yield "switched", tried(switched, c.PumaSimError)
    yield "servo", tried(lambda: packed(simulator().run_servo(targets, acceleration=True)), c.PumaSimError)
    yield "chain", tried(lambda: packed(simulator().run_servo(targets, chain)), c.PumaSimError)


def batch_runs(c: SimpleNamespace, rows: int) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of runs side by side: plain arms in lanes, others alone."""
    times, volts = drive(rows)
    sets = ("bejczy", "paul", "tuned", "average")
    plain = [c.Plant.of(sets[k % len(sets)]) for k in range(11)]
    mixed = list(plain)
    for k, texts in (
        (2, TOGETHER["amplifiers"]),
        (5, TOGETHER["dry_and_bristle"]),
        (7, TOGETHER["two_masses_and_play"]),
    ):
        mixed[k] = c.Plant.of("bejczy", tuple(map(c.parse_effect, texts)))
    each = np.stack([np.round(volts * (1.0 - 0.05 * k), 6) for k in range(11)])
    starts = np.array(START) + 0.02 * np.arange(11)[:, None]
    for name, plants, voltage, lanes, workers in (
        ("lanes", plain, volts, True, 1),
        ("lanes_mixed", mixed, each, True, 2),
        ("alone", plain[:3], each[:3], False, 1),
    ):
        place = starts[: len(plants)]
        module = sys.modules[c.run_batch.__module__]
        start = {"start": module.InitialState(place)} if hasattr(module, "InitialState") else {"position": place}
        run = c.run_batch(plants, times, voltage, **start, lanes=lanes, workers=workers)
        yield name, packed(run)


def one_joint_runs(c: SimpleNamespace, rows: int) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of runs of the mechanisms of one joint."""
    times, volts = drive(rows, 1)
    for name in ("pendulum", "slide"):
        mechanism = c.load_mechanism(name)
        for text in ("", "coulomb_friction:joint=1,torque=0.5", "backlash:joint=1,gap=0.003,stiffness=2000"):
            effects = tuple(map(c.parse_effect, filter(None, [text])))

            def run(mechanism=mechanism, effects=effects):
                simulator = c.Simulator(mechanism.plant(mechanism.start, effects))
                simulator.reset((0.1,))
                return packed(simulator.run(times, 0.1 * volts, acceleration=True))

            yield f"{name}-{text.partition(':')[0] or 'none'}", tried(run, c.PumaSimError)


def effects_of_backend(out: Path, quick: bool) -> None:
    """Record the effects with the kernel of this process."""
    c = core()
    found = cases(c)
    rows = 80
    if quick:
        found = {name: texts for name, texts in found.items() if name[-2:] not in ("-1", "-3")}
    for n, (name, texts) in enumerate(found.items()):
        for way, content in effect_runs(c, texts, rows):
            (out / f"{name}.{way}.f64").write_bytes(content)
        if n % 20 == 19 or n + 1 == len(found):
            say(f"  {out.name}: {n + 1} of {len(found)}")
    for name, content in batch_runs(c, rows):
        (out / f"batch.{name}.f64").write_bytes(content)
    for name, content in one_joint_runs(c, rows):
        (out / f"one_joint.{name}.f64").write_bytes(content)
    say(f"  {out.name}: batches and one joint")
    (out / "effects.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")


def record_effects(out: Path, quick: bool) -> None:
    """Record the effects on both kernels, which give the same bits but for lanes."""
    for backend in BACKENDS:
        folder = out / backend
        folder.mkdir()
        with tempfile.TemporaryDirectory() as work:
            arguments = [
                str(Path(__file__).resolve()),
                "effects-of-backend",
                "--out",
                str(folder),
                *(["--quick"] if quick else []),
            ]
            start(arguments, Path(work), backend, shown=True)
            times, volts = drive(40)
            lines = ["time,voltage1,voltage2,voltage3"]
            lines += [",".join(map(repr, row)) for row in np.column_stack([times, volts]).tolist()]
            Path(work, "volts.csv").write_text("\n".join(lines) + "\n")
            for name in ("dry_and_bristle", "delay_and_sensors"):
                effects = [part for text in TOGETHER[name] for part in ("--effect", text)]
                puma_sim(
                    Path(work), "simulate", "volts.csv", "--out", folder / f"{name}.csv",
                    "--initial", "0.1,-1.1,0.9", *effects, backend=backend,
                )  # fmt: skip


# --------------------------------------------------------------------------------------------- bags


def sessions(c: SimpleNamespace) -> dict[str, tuple]:
    """Effects, command interface, servo and further settings of each session, by name."""
    friction, play, late = (TOGETHER[name] for name in ("dry_and_bristle", "two_masses_and_play", "delay_and_sensors"))
    amplifiers, stop = TOGETHER["amplifiers"], TOGETHER["stop_and_blow"]
    ideal = c.ServoConfig()
    chain = c.ServoConfig(amplifier_gain=2.0, converter_bits=12, encoder_counts=1000, delay_samples=1)
    scheduled, computed = {"controller": "scheduled"}, {"controller": "computed_torque"}
    return {
        "voltage": ((), "voltage", ideal, {}),
        "voltage_friction": (friction, "voltage", ideal, {}),
        "voltage_amplifiers": (amplifiers, "voltage", ideal, {}),
        "voltage_stop": (stop, "voltage", ideal, {}),
        "voltage_two_mass": (play, "voltage", ideal, {}),
        "voltage_delay": (late, "voltage", ideal, {}),
        "servo": ((), "position", ideal, {}),
        "servo_chain": (friction, "position", chain, {}),
        "servo_delay": (late, "position", chain, {}),
        "servo_two_mass": (play, "position", ideal, {}),
        "scheduled": ((), "position", ideal, scheduled),
        "scheduled_chain": (friction, "position", chain, scheduled),
        "scheduled_two_mass": (play, "position", ideal, scheduled),
        "computed_torque": ((), "position", ideal, computed),
        "computed_torque_delay": (late, "position", chain, computed),
        "computed_torque_two_mass": (play, "position", ideal, computed),
    }


def commands_before(step: int, interface: str, rng: np.random.Generator) -> list[tuple]:
    """Names and values of the commands before a step: none, one, several, some that are clipped."""
    if 30 <= step < 55 or step % 4 == 1:
        return []
    if interface == "voltage":
        return [(None, tuple(rng.uniform(-35.0, 35.0, 3).tolist())) for _ in range(1 + step % 2)]
    if step % 3:
        return [(("joint3", "joint1"), tuple(rng.uniform(0.0, 0.5, 2).tolist()))]
    return [(None, (0.1, -1.0, 0.8 + step / 200)), (("joint2",), (-1.1,))]


def record_session(c: SimpleNamespace, path: Path, config, steps: int, commands: Callable) -> None:
    """Run a session and write its bag; commands(step) as `commands_before`."""
    session = c.Session(config)
    with c.BagRecorder(
        path,
        config_text=c.yaml_text(config.to_mapping()),
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface=config.command_interface,
        period_ns=config.period_ns,
    ) as recorder:
        for step in range(steps + 1):
            recorder.write_state(session.state)
            if step < steps:
                for names, values in commands(step):
                    if names is None:
                        session.command(values)
                    else:
                        session.command_joints(names, values)
                    recorder.write_command(session.state.time_ns, c.RecordedCommand(names, values))
                session.step()


def record_bags(out: Path, quick: bool) -> None:
    """Record sessions; time is that of the session, so that no clock comes in."""
    c = core()
    for name, (texts, interface, servo, more) in sessions(c).items():
        if quick and not name.endswith(("voltage", "servo", "chain", "two_mass")):
            continue
        rng = np.random.default_rng(5)
        config = c.SessionConfig(
            c.Plant.of("bejczy", tuple(map(c.parse_effect, texts))),
            interface,
            initial_position=START,
            voltage_limit=30.0,
            command_timeout=0.2,
            servo=servo,
            **more,
        )
        record_session(
            c, out / name, config, 80, lambda step, interface=interface, rng=rng: commands_before(step, interface, rng)
        )
        say(f"  {name}")


# ------------------------------------------------------------------------------------------ reports

PENDULUM = "time=t_s,voltage1=motor_V,position1=q_rad,enable=torque_enable"
EMPS = "time=t_s,voltage1=vir_V,position1=q_meas_m"


def record_bag_to_explain(path: Path) -> None:
    """A session of 8 s under the servo, one sample a period, with dry friction that the model lacks."""
    c = core()
    effect = c.parse_effect("coulomb_friction:joint=2,torque=15")
    config = c.SessionConfig(
        c.Plant.of("bejczy", (effect,)),
        "position",
        period=0.004,
        substeps=1,
        initial_position=START,
        servo=c.ServoConfig(encoder_counts=1000),
    )

    def targets(step):
        t = 0.004 * step
        turns = [0.35 * math.sin(w * t) + 0.15 * math.sin(2.7 * w * t) for w in (2.1, 1.7, 2.6)]
        return [(None, tuple(q + turn for q, turn in zip(START, turns, strict=True)))]

    record_session(c, path, config, 2000, targets)


def reports(work: Path) -> dict[str, list[str]]:
    """Arguments of `explain`, by name; the logs are put into the folder where it runs.

    Raises
    ------
    SystemExit : PUMA_SIM_DATA is not set.
    """
    if "PUMA_SIM_DATA" not in os.environ:
        sys.exit("reports need the folder of measured logs: set PUMA_SIM_DATA")
    data = Path(os.environ["PUMA_SIM_DATA"])
    found: dict[str, list[str]] = {}
    # a fault, an effect, no effect, two effects, outside the library (2), effects (2)
    for number in (1020, 1011, 1000, 1016, 1018, 1019, 1005, 1008):
        path = RECORDS / f"record_{number:06}.csv"
        shutil.copy(path, work)
        found[path.stem] = [path.name]
    for name, mechanism, columns in (
        ("emps/emps_train.csv", "slide", EMPS),
        ("xl330_pendulum/xl330_kp100_lift_and_drop.csv", "pendulum", PENDULUM),
        ("xl330_pendulum/xl330_kp400_sin_sin.csv", "pendulum", PENDULUM),
    ):
        shutil.copy(data / name, work)
        found[Path(name).stem] = [Path(name).name, "--plant", mechanism, "--columns", columns]
    record_bag_to_explain(work / "bag")
    found["bag"] = ["bag"]
    return found


#: a fault, a name, no name and a machine of one joint, those that are explained fastest
QUICK_REPORTS = ("record_001020", "record_001011", "record_001019", "xl330_kp400_sin_sin")


def record_reports(out: Path, quick: bool) -> None:
    """Explain logs, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        chosen = {name: each for name, each in reports(work).items() if not quick or name in QUICK_REPORTS}
        for n, (name, arguments) in enumerate(chosen.items()):
            begin = time.perf_counter()
            puma_sim(work, "explain", *arguments, "--out", "report")
            (out / name).mkdir()
            content = json.loads((work / "report" / "report.json").read_text())
            # the time that it took
            del content["seconds"]
            write_json(out / name / "report.json", content)
            if (work / "report" / "model.yaml").exists():
                shutil.copy(work / "report" / "model.yaml", out / name)
            shutil.rmtree(work / "report")
            took = time.perf_counter() - begin
            say(f"  {n + 1} of {len(chosen)}: {name}: {content['verdict']}, {took:.0f} s")


def write_json(path: Path, content) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")


# ------------------------------------------------------------------------------------------- thesis

#: experiments that take a few seconds together
QUICK_EXPERIMENTS = ("2.4", "4.3", "4.4", "4.5")


def record_thesis(out: Path, quick: bool) -> None:
    """Run the experiments of the thesis; its JSON has no time as measured."""
    with tempfile.TemporaryDirectory() as work:
        puma_sim(Path(work), "thesis", *(QUICK_EXPERIMENTS if quick else ["--all"]), "--out", "page")
        (path,) = Path(work, "page").glob("*.json")
        content = json.loads(path.read_text())
    for experiment in content.pop("experiments"):
        write_json(out / f"{experiment['number']}.json", experiment)
    write_json(out / "head.json", content)
    say(f"  {len(list(out.iterdir())) - 1} experiments")


# ------------------------------------------------------------------------------------ record, compare


def record(options: argparse.Namespace) -> int:
    """Record the parts that were asked for."""
    os.environ["PUMA_SIM_KERNEL"] = "numba"
    used = checkout()
    say(f"puma_sim_core of {used}")
    out = Path(options.out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    for part in options.only:
        begin = time.perf_counter()
        say(f"{part}:")
        folder = out / part
        shutil.rmtree(folder, ignore_errors=True)
        (out / f"{part}.about.json").unlink(missing_ok=True)
        folder.mkdir()
        WRITERS[part](folder, options.quick)
        write_index(folder)
        took = time.perf_counter() - begin
        # a part without this file is not complete; nothing in it is compared
        write_json(out / f"{part}.about.json", {"checkout": str(used), "quick": options.quick, "seconds": took})
        say(f"{part}: {took:.0f} s")
    return 0


WRITERS = {"effects": record_effects, "bags": record_bags, "reports": record_reports, "thesis": record_thesis}


#: keys whose text is a result, whatever words are in it
RESULTS = ("axis", "command", "ours", "printed")


def is_sentence(value, key: str) -> bool:
    """Whether a value of JSON is prose: several words, one of them not of digits."""
    return isinstance(value, str) and key not in RESULTS and re.search(r"[A-Za-z]{2}", value) and " " in value


def first_difference(a, b) -> int:
    """Where two sequences begin to differ."""
    return next((n for n, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def both_shown(one, other) -> str:
    """Two values from shortly before the place where their JSON begins to differ."""
    texts = [json.dumps(each, ensure_ascii=False) for each in (one, other)]
    first = max(first_difference(*texts) - 20, 0)
    return " and ".join(f"{'...' if first else ''}{text[first : first + 80]}" for text in texts)


def differing_paths(one, other, prose: bool, where: str = "") -> Iterator[str]:
    """Where two JSON values differ, as lines; prose: whether sentences count."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other}):
            if key not in one or key not in other:
                yield f"{where}/{key}: only in the {'first' if key in one else 'second'}"
            else:
                yield from differing_paths(one[key], other[key], prose, f"{where}/{key}")
        if list(one) != list(other) and set(one) == set(other):
            yield f"{where or '/'}: the order of its keys"
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{where}: {len(one)} and {len(other)} entries"
        for n, (a, b) in enumerate(zip(one, other, strict=False)):
            yield from differing_paths(a, b, prose, f"{where}/{n}")
    elif json.dumps(one) != json.dumps(other):
        key = where.rpartition("/")[2]
        if prose or not (is_sentence(one, key) and is_sentence(other, key)):
            yield f"{where}: {both_shown(one, other)}"


def differences(one: Path, other: Path, prose: bool) -> list[str]:
    """How two files differ, as lines; none where they are equal."""
    a, b = one.read_bytes(), other.read_bytes()
    if a == b:
        return []
    if one.suffix == ".json":
        found = list(differing_paths(json.loads(a), json.loads(b), prose))
        return [*found[:5], *([f"and {len(found) - 5} more"] if len(found) > 5 else [])]
    if one.suffix == ".f64" and len(a) == len(b) and len(a) % 8 == 0:
        x, y = np.frombuffer(a, "<f8"), np.frombuffer(b, "<f8")
        unequal = np.flatnonzero(x.view("<u8") != y.view("<u8"))
        with np.errstate(invalid="ignore"):
            greatest = np.abs(x - y)[unequal].max()
        return [f"{len(unequal)} of {len(x)} numbers, the first is number {unequal[0]}, the greatest by {greatest:.3g}"]
    if one.suffix == ".yaml" and not prose:
        return list(differing_paths(yaml.safe_load(a), yaml.safe_load(b), prose))[:5]
    if one.suffix in (".yaml", ".csv"):
        lines = zip(a.decode().splitlines(), b.decode().splitlines(), strict=False)
        for n, (x, y) in enumerate(lines):
            if x != y:
                return [f"line {n + 1}: {x.strip()[:90]} and {y.strip()[:90]}"]
    return [f"{len(a)} and {len(b)} bytes, the first difference is at byte {first_difference(a, b)}"]


def compare(options: argparse.Namespace) -> int:
    """List what differs between two recordings; 1 where anything does."""
    roots = (Path(options.first), Path(options.second))
    differing = equal = 0
    for part in options.only:
        about = [root / f"{part}.about.json" for root in roots]
        there = [path.exists() for path in about]
        if not any(there):
            say(f"{part}: in neither")
            continue
        if not all(there):
            say(f"{part}: not complete in {roots[there.index(False)]}")
            differing += 1
            continue
        quick = [json.loads(path.read_text())["quick"] for path in about]
        files = [
            {str(path.relative_to(root / part)) for path in (root / part).rglob("*") if path.is_file()}
            for root in roots
        ]
        for n in (0, 1):
            # the other recording was made with --quick and does not have all
            if quick[1 - n] and not quick[n]:
                files[n] &= files[1 - n]
        for name in sorted(files[0] | files[1]):
            if name == "index.json" or (Path(name).name == "effects.json" and quick[0] != quick[1]):
                continue
            missing = [root for root, found in zip(roots, files, strict=True) if name not in found]
            if missing:
                found = [f"not in {missing[0]}"]
            else:
                found = differences(*(root / part / name for root in roots), not options.apart_from_prose)
            equal += not found
            differing += bool(found)
            if found:
                say("\n    ".join([f"{part}/{name}", *found]))
    say(f"{differing} differ, {equal} are equal")
    return int(differing > 0 or equal == 0)


def parts_of(text: str) -> list[str]:
    """The parts of --only."""
    found = text.split(",")
    for each in found:
        if each not in PARTS:
            raise argparse.ArgumentTypeError(f"'{each}' is none of {', '.join(PARTS)}")
    return found


def main() -> int:
    """Read the command line and do it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("record", "compare", "effects-of-backend"):
        each = commands.add_parser(name)
        if name != "compare":
            each.add_argument("--out", required=True, metavar="DIR")
            each.add_argument("--quick", action="store_true", help="less of each part")
        else:
            each.add_argument("first", metavar="DIR1")
            each.add_argument("second", metavar="DIR2")
            each.add_argument(
                "--apart-from-prose", action="store_true", help="let texts of JSON and YAML with a space in them differ"
            )
        each.add_argument("--only", type=parts_of, default=list(PARTS), metavar="PART,...")
    options = parser.parse_args()
    if options.command == "record":
        return record(options)
    if options.command == "compare":
        return compare(options)
    checkout()
    effects_of_backend(Path(options.out), options.quick)
    return 0


if __name__ == "__main__":
    sys.exit(main())
