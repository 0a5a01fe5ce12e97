# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""From a recorded session to the name of what the model lacks:
`python examples/sessions/loop.py --out DIR`.

Writes a model that differs from the published one by an effect and by parameters some per cent
off into DIR/hidden, lets `sim_node` run it under a controller in another process, and gives the
bag, and nothing else, to `puma-sim explain`. What that names is then shown beside what was hidden.
(A bag of `sim_node` also tells which model made it, for replays; `explain` does not look at it.)
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from exciting_motion import MIDDLE
from two_programs import ProgramError, as_program, environment, run_session

from puma_sim_core.compiling import Compilation
from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.model_file import dump_model, load_model
from puma_sim_core.plant.plant import Plant

#: what is hidden where nothing else is asked for: levels like those that Corke measured on joint 2
EFFECT = "asymmetric_coulomb_friction:joint=2,positive=12.6,negative=7.1"
#: between two commands, and so between two rows of the log [s]; steps of integration in each
PERIOD, SUBSTEPS = 0.01, 10
#: greatest share by which a parameter is off; viscous friction, and all others
_OFF_VISCOUS, _OFF = 0.20, 0.05
#: longest time for the motion, and for the explanation [s]; the model is compiled before that begins
_PATIENCE = 900.0


def hide(folder: Path, effects: Sequence[Effect], seed: int) -> Path:
    """Write a model with these effects and with parameters off by some per cent; its path."""
    mechanism, random = load_mechanism(), np.random.default_rng(seed)
    share = np.array([_OFF_VISCOUS if p.name.endswith("viscous") else _OFF for p in mechanism.free])
    theta = mechanism.start * (1.0 + share * random.uniform(-1.0, 1.0, share.size))
    folder.mkdir(parents=True, exist_ok=True)
    dump_model(mechanism.plant(theta, effects), folder / "model.yaml")
    return folder / "model.yaml"


def record(out: Path, model: Path, duration: float, seed: int) -> Path:
    """A session of `sim_node` with a model under the exciting controller; the bag's path."""
    node = {
        "mode": "lockstep",
        "model": model,
        "period": PERIOD,
        "substeps": SUBSTEPS,
        "initial_position": str([float(q) for q in MIDDLE]),
    }
    # the interpreter is done with this sooner than the kernel is loaded; the bits are the same
    bag, _ = run_session(
        out, node, "exciting_controller", {"duration": duration, "seed": seed}, _PATIENCE, PUMA_SIM_KERNEL="python"
    )
    return bag


def explain(bag: Path, out: Path) -> dict:
    """Run `puma-sim explain` on the bag in a process of its own; its report.json."""
    done = subprocess.run(
        [sys.executable, "-m", "puma_sim_core", "explain", str(bag), "--out", str(out), "--force"],
        stdout=subprocess.DEVNULL,
        # its matrices are small: threads would only wait for one another
        env=environment(OPENBLAS_NUM_THREADS="1"),
        timeout=_PATIENCE,
    )
    if done.returncode != 0:
        raise ProgramError(f"puma-sim explain ended with status {done.returncode}", where=bag)
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def _place(joint: int | None) -> str:
    return "the whole arm" if joint is None else f"joint {joint}"


def _hidden_lines(plant: Plant) -> list[str]:
    """The effects of the hidden model; its viscous friction is one of the parameters."""
    lines = []
    for effect in plant.effects:
        if effect.kind.name != "viscous_friction":
            units = {p.name: p.unit for p in effect.kind.parameters}
            lines.append(
                f"{effect.kind.name}, {_place(effect.joint)}: "
                + ", ".join(f"{name} {value:g} {units[name]}" for name, value in effect.values.items())
            )
    return lines or ["no effect"]


def _named_lines(report: dict) -> list[str]:
    lines = []
    for effect in report["effects"]:
        values = (
            f"{name} {found['value']:.4g} {found['unit']} (95 %: "
            + " to ".join("no bound" if end is None else f"{end:.4g}" for end in found["ci95"])
            + ")"
            for name, found in effect["parameters"].items()
        )
        lines.append(f"{effect['name']}, {_place(effect['joint'])}: {', '.join(values)}")
        lines += [f"  cannot be told from it: {each['name']}, {_place(each['joint'])}" for each in effect["tied_with"]]
    return lines or ["no effect"]


def _error_lines(errors: dict | None) -> list[str]:
    """Errors on blocks that were not fitted, joint by joint."""
    if errors is None:
        return []
    stages = ("nominal", "retuned", "augmented", "floor")
    lines = [f"{'held out, rms':25}" + "".join(f"{stage:>11}" for stage in stages)]
    for key, what, factor in (
        ("voltage_rms", "voltage, joint {} [mV]", 1e3),
        ("position_rms", "position, joint {} [mrad]", 1e3),
    ):
        for j in range(len(errors[key]["nominal"])):
            values = (errors[key][stage][j] for stage in stages)
            lines.append(
                f"  {what.format(j + 1):<23}"
                + "".join(f"{'-':>11}" if value is None else f"{value * factor:11.3f}" for value in values)
            )
    return lines


def _block(title: str, lines: list[str]) -> str:
    return f"{title:<9}" + f"\n{'':9}".join(lines)


def run(out: Path, effects: Sequence[Effect], duration: float, seed: int) -> None:
    """The demonstration; raises PumaSimError when something of it fails."""
    out.mkdir(parents=True, exist_ok=True)
    print(
        f"sim_node with a hidden model and a controller, two processes over DDS: {duration:g} s "
        "of motion in lockstep.\nThe whole takes about half a minute, a minute or two more when the model is "
        "first compiled.",
        flush=True,
    )
    compilation = Compilation(lambda text: print(text, flush=True))
    began = time.monotonic()
    model = hide(out / "hidden", effects, seed)
    bag = record(out, model, duration, seed)
    log = read_log(bag)
    print(
        f"recorded: {len(log)} rows, one each {1e3 * PERIOD:g} ms, in "
        f"{time.monotonic() - began:.1f} s\n\n"
        f"puma-sim explain {bag} --out {out / 'report'}",
        flush=True,
    )
    compilation.wait()
    report = explain(bag, out / "report")
    print(f"verdict: {report['verdict']} ({report['seconds']:.1f} s)\n{report['sentence']}\n")
    print(
        _block(
            "hidden:",
            [
                *_hidden_lines(load_model(model)),
                f"parameters off by up to {100 * _OFF:g} %, viscous friction by up to {100 * _OFF_VISCOUS:g} %",
            ],
        )
    )
    print(_block("named:", _named_lines(report)) + "\n")
    for line in _error_lines(report["errors"]["held_out"]):
        print(line)
    print()
    for title, path in (
        ("hidden model", model),
        ("bag", bag),
        ("report", out / "report" / "report.html"),
        ("as JSON", out / "report" / "report.json"),
        ("new model", out / "report" / "model.yaml"),
    ):
        if path.exists():
            print(f"{title + ':':<14}{path}")
    print(f"{time.monotonic() - began:.0f} s in all")


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python examples/sessions/loop.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for all that is made")
    parser.add_argument(
        "--effect",
        metavar="EFFECT",
        action="append",
        help=f"what to hide, once or more (default: {EFFECT}); none: nothing",
    )
    parser.add_argument(
        "--duration", type=float, default=20.0, metavar="S", help="length of the motion [s] (default 20)"
    )
    parser.add_argument(
        "--seed", type=int, default=4, metavar="N", help="of the hidden parameters and of the motion (default 4)"
    )
    options = parser.parse_args(args)

    def work() -> None:
        effects = [parse_effect(text) for text in options.effect or [EFFECT] if text != "none"]
        run(options.out, effects, options.duration, options.seed)

    return as_program("loop_demo", work)


if __name__ == "__main__":
    sys.exit(main())
