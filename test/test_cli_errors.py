# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Bad input of `puma-sim`: one line says what, where and what was expected; nothing is written."""

from __future__ import annotations

import re

import pytest
import yaml
from cli_support import HEADER, call, contents, puma_sim, random_volts, write_volts

from puma_sim_core.arm.parameters import load_parameters, to_mapping
from puma_sim_core.files import yaml_text
from puma_sim_core.plant.model_file import dump_model
from puma_sim_core.plant.plant import Plant

GOOD = f"{HEADER}\n0,1,2,3\n0.5,1,2,3\n1,0,0,0\n"


@pytest.fixture
def assert_refused(tmp_path, capsys):
    """Runs a command that must fail: one line with the three parts, and the folder as it was."""

    def check(*arguments, says):
        before = contents(tmp_path)
        capsys.readouterr()
        assert call(*arguments) == 2
        out, err = capsys.readouterr()
        lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
        assert out == "" and len(lines) == 1, err
        assert re.fullmatch(r"puma-sim: .+; expected .+", lines[0])
        for part in says:
            assert part in lines[0]
        assert contents(tmp_path) == before
        return lines[0]

    return check


@pytest.fixture
def volts(tmp_path):
    path = tmp_path / "volts.csv"
    path.write_text(GOOD)
    return path


def rows(*lines):
    return "".join(f"{line}\n" for line in (HEADER, *lines))


# ------------------------------------------------------------------------------- voltage files


@pytest.mark.parametrize(
    "text, says",
    [
        ("", ["bad.csv: is empty", "expected a line of column names"]),
        ("\n  \n# nothing\n", ["bad.csv: is empty"]),
        (f"{HEADER}\n", ["bad.csv: has no rows", "at least one row"]),
        (
            "time,voltage1,voltage3\n0,1,2\n",
            ["bad.csv, line 1: column 'voltage2' is missing", "time, voltage1, voltage2, voltage3"],
        ),
        ("voltage1,voltage2,voltage3\n0,1,2\n", ["line 1: column 'time' is missing"]),
        ("0,1,2,3\n1,1,2,3\n", ["line 1: column 'time' is missing", "time, voltage1", "there are 0, 1, 2, 3"]),
        (f"# a\n{HEADER.replace('voltage2', 'voltge2')}\n0,1,2,3\n", ["line 2: column 'voltage2'", "voltge2"]),
        (f"{HEADER},voltage2\n0,1,2,3,4\n", ["line 1: column 'voltage2' stands twice"]),
        (
            rows("0,1,2,3", "0.5,1,2,3", "0.5,1,2,3"),
            ["bad.csv, line 4, column time: time 0.5 after 0.5", "times that increase"],
        ),
        (rows("0,1,2,3", "# pause", "2,1,2,3", "1,1,2,3"), ["bad.csv, line 5, column time: time 1.0 after 2.0"]),
        (rows("0,1,2,3", "0.5,nan,2,3"), ["line 3, column voltage1: nan", "a finite number"]),
        (rows("0,1,2,3", "0.5,1,-inf,3"), ["line 3, column voltage2: -inf", "a finite number"]),
        (rows("0,1,2,3", "0.5,1,2,1e999"), ["line 3, column voltage3: 1e999", "a finite number"]),
        (rows("NaN,1,2,3"), ["line 2, column time: NaN", "a finite number"]),
        (rows("0,1,2,3", "0.5,1,two,3"), ["line 3, column voltage2: 'two'", "a number"]),
        (rows("0,1,2,3", "0.5,1,,3"), ["line 3, column voltage2: ''", "a number"]),
        (rows("0,1,2,3", "0.5,1,2_0,3"), ["line 3, column voltage2: '2_0'", "a number"]),
        (rows("0,1,2,3", "0.5,1,2,3 # note"), ["line 3, column voltage3: '3 # note'", "a number"]),
        (rows("0,1,2,3", "0.5;1;2;3"), ["line 3: 1 field", "4 numbers, one a column"]),
        (rows("0,1,2,3", "0.5,1,2,3,4"), ["line 3: 5 fields", "4 numbers"]),
        (rows("0,1,2,3") + "0.5,1,2", ["bad.csv, line 3: 3 fields", "4 numbers, one a column"]),
        (rows("0,1,2,3") + "0.5,1,2,", ["line 3, column voltage3: ''", "a number"]),
        (rows("0,1,2,3") + "0.5,1,2,3e", ["line 3, column voltage3: '3e'", "a number"]),
        (rows("0,1,2,3", '0.5,"1,2,3'), ["line 3: 2 fields"]),
    ],
)
def test_a_voltage_file_that_cannot_be_used_is_refused(tmp_path, assert_refused, text, says):
    bad = tmp_path / "bad.csv"
    bad.write_text(text)
    assert_refused("simulate", bad, "--out", tmp_path / "run.csv", says=says)


def test_a_file_that_is_not_text_is_refused(tmp_path, assert_refused):
    bad = tmp_path / "bad.csv"
    bad.write_bytes(GOOD.encode() + b"\xff\xfe\x00")
    assert_refused("simulate", bad, "--out", tmp_path / "run.csv", says=["bad.csv: is not text"])
    bad.write_bytes(GOOD.encode() + b"\x00" * 20)
    assert_refused("simulate", bad, "--out", tmp_path / "run.csv", says=["bad.csv: is not text"])


def test_files_that_are_not_there_are_named(tmp_path, assert_refused):
    out = tmp_path / "run.csv"
    assert_refused("simulate", tmp_path / "no.csv", "--out", out, says=["no.csv: cannot be read"])
    assert_refused("simulate", tmp_path, "--out", out, says=[f"{tmp_path}: cannot be read"])
    (tmp_path / "volts.csv").write_text(GOOD)
    for command in ("simulate", "explain", "plot", "view"):
        words = (command, tmp_path / "vols.csv", *(() if command == "view" else ("--out", tmp_path / "run.png")))
        assert_refused(
            *words, says=[f"vols.csv: cannot be read (No such file or directory); expected a file; {tmp_path}"]
        )


def test_what_cannot_be_used_ends_the_command_before_anything_is_compiled(tmp_path, volts):
    words = ("simulate", volts, "--out", tmp_path / "run.csv", "--effect", "coulom_friction:joint=1")
    process = puma_sim(*words, PUMA_SIM_KERNEL="auto", NUMBA_CACHE_DIR=str(tmp_path))
    assert process.returncode == 2 and len(process.stderr.splitlines()) == 1, process.stderr
    assert not [*tmp_path.rglob("*.nbi"), *tmp_path.rglob("compiled-log")]


@pytest.mark.parametrize("cut", range(1, 8))
def test_a_file_cut_off_in_its_last_row_is_refused_or_warned_of(tmp_path, capsys, cut):
    """Where the cut leaves as many numbers as there should be, only the end of line is missing."""
    whole = rows("0,1.5,2.5,3.5", "1,1.5,2.5,3.5")
    path = tmp_path / "cut.csv"
    path.write_text(whole[:-cut])
    status = call("simulate", path, "--out", tmp_path / "run.csv")
    err = capsys.readouterr().err
    if status == 0:
        assert "warning" in err and "cut.csv: the last line does not end" in err
    else:
        assert "cut.csv, line 3" in err and not (tmp_path / "run.csv").exists()


def test_a_process_ends_with_one_line_and_status_2(tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_text(rows("0,1,2,3", "0.5,1,two,3"))
    done = puma_sim("simulate", bad, "--out", tmp_path / "run.csv")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr == (f"puma-sim: {bad}, line 3, column voltage2: 'two'; expected a number\n")
    assert list(contents(tmp_path)) == ["bad.csv"]


# ------------------------------------------------------------------------------ parameter files


def changed(change):
    mapping = to_mapping(load_parameters("bejczy"))
    change(mapping)
    return mapping


def set_radii(mapping):
    """Table 7.1 as printed, which no arm has."""
    for link, radii in zip(("link2", "link3"), ((0.0516, 0.1900, 0.0031), (0.0510, 0.0691, 0.0027))):
        mapping["links"][link]["gyration_squared"]["value"] = list(radii)
    for joint, inertia in zip(("joint2", "joint3"), (0.23616, 0.05827)):
        mapping["motors"][joint]["inertia"]["value"] = inertia


PARAMETER_FAULTS = {
    "unknown key": (
        lambda m: m["links"]["link1"].update(weight=1),
        ["links.link1.weight: unknown key", "one of mass, centre"],
    ),
    "unknown key at the top": (lambda m: m.update(friction={}), ["friction: unknown key"]),
    "missing key": (lambda m: m["motors"]["joint2"].pop("inertia"), ["motors.joint2.inertia: missing"]),
    "unit": (
        lambda m: m["links"]["link2"]["mass"].update(unit="lb"),
        ["links.link2.mass.unit: unit 'lb'", "expected kg"],
    ),
    "length": (
        lambda m: m["links"]["link3"]["centre"].update(value=[0.1, 0.2]),
        ["links.link3.centre", "3 finite numbers"],
    ),
    "text": (
        lambda m: m["motors"]["joint1"]["resistance"].update(value="1.6 ohm"),
        ["motors.joint1.resistance", "1.6 ohm", "a finite number"],
    ),
    "sign": (lambda m: m["links"]["link1"]["mass"].update(value=-1.0), ["links.link1.mass", "-1.0", "above 0 kg"]),
    "not positive definite": (
        set_radii,
        ["D + Ia is not positive definite", "kg.m^2 at q2 =", "deg", "eigenvalues above 0"],
    ),
}


@pytest.mark.parametrize("fault", PARAMETER_FAULTS)
@pytest.mark.parametrize("inside", ["parameters", "model"])
def test_a_parameter_file_that_cannot_be_used_is_refused(tmp_path, volts, assert_refused, fault, inside):
    change, says = PARAMETER_FAULTS[fault]
    bad = tmp_path / "bad.yaml"
    mapping = changed(change)
    if inside == "model":
        mapping = {**Plant.of().to_mapping(), "parameters": mapping}
    bad.write_text(yaml_text(mapping))
    assert_refused("simulate", volts, "--out", tmp_path / "run.csv", f"--{inside}", bad, says=["bad.yaml", *says])


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda m: m.update(format="puma-sim model 99"), ["format 'puma-sim model 99'"]),
        (lambda m: m.update(colour="blue"), ["unknown key 'colour'"]),
        (lambda m: m.update(torque_form="wrong"), ["torque_form 'wrong'", "physical or printed"]),
        (lambda m: m["effects"][0].update(name="magic"), ["unknown effect 'magic'", "`puma-sim list`"]),
        (lambda m: m["effects"][0]["torque"].update(unit="V"), ["coulomb_friction", "unit: N.m"]),
        (lambda m: m["effects"][0]["torque"].update(value=-1.0), ["torque=-1", "0 to 500 N.m"]),
        (lambda m: m["effects"][0].update(joint=4), ["joint", "1, 2 or 3"]),
    ],
)
def test_a_model_file_that_cannot_be_used_is_refused(tmp_path, volts, assert_refused, change, says):
    bad = tmp_path / "bad.yaml"
    dump_model(Plant.of(effects=[_coulomb()]), bad)
    mapping = yaml.safe_load(bad.read_text())
    change(mapping)
    bad.write_text(yaml_text(mapping))
    assert_refused("simulate", volts, "--out", tmp_path / "run.csv", "--model", bad, says=["bad.yaml", *says])


def _coulomb():
    from puma_sim_core.effects import parse_effect

    return parse_effect("coulomb_friction:joint=2,torque=12")


@pytest.mark.parametrize(
    "text, says",
    [
        ("a: [1", ["bad.yaml, line", "YAML"]),
        ("a: 1\na: 2\n", ["bad.yaml, line 2", "'a' stands twice"]),
        ("", ["bad.yaml"]),
        ("- 1\n", ["bad.yaml"]),
    ],
)
@pytest.mark.parametrize("option", ["--parameters", "--model"])
def test_a_file_that_is_no_model_is_refused(tmp_path, volts, assert_refused, text, says, option):
    bad = tmp_path / "bad.yaml"
    bad.write_text(text)
    assert_refused("simulate", volts, "--out", tmp_path / "run.csv", option, bad, says=says)


# -------------------------------------------------------------------------------------- options


@pytest.mark.parametrize(
    "options, says",
    [
        (["--parameters", "pual"], ["no parameter set or file 'pual'", "bejczy"]),
        (["--max-step", "0.0081"], ["--max-step: 8.1 ms", "at most 8 ms"]),
        (["--max-step", "0"], ["--max-step: 0 ms", "more than 0"]),
        (["--max-step", "-0.001"], ["--max-step: -1 ms"]),
        (["--max-step", "nan"], ["--max-step: 'nan'", "a finite number"]),
        (["--max-step", "1ms"], ["--max-step: '1ms'", "a finite number"]),
        (["--initial", "1,2"], ["--initial: '1,2'", "three finite numbers", "[rad]"]),
        (["--initial", "-1,2,nan"], ["--initial: '-1,2,nan'", "three finite numbers"]),
        (["--initial-velocity", "1,2,3,4"], ["--initial-velocity: '1,2,3,4'", "[rad/s]"]),
        (["--initial-current", "a,b,c"], ["--initial-current: 'a,b,c'", "[A]"]),
        (["--effect", "magic"], ["unknown effect 'magic'", "`puma-sim list`"]),
        (["--effect", "coulom_friction:joint=2"], ["unknown effect 'coulom_friction'; expected coulomb_friction or"]),
        (["--effect", "coulomb_friction:torque=3"], ["effect coulomb_friction: no joint", "joint=1, 2 or 3"]),
        (["--effect", "coulomb_friction:joint=2,torqe=3"], ["unknown parameter 'torqe'", "one of torque"]),
        (["--parameters", "bejzy"], ["no parameter set or file 'bejzy'", "one of bejczy"]),
        (["--plant", "pendulom"], ["no mechanism or file 'pendulom'", "one of pendulum"]),
        (["--plant", "pendulum", "--model", "m.yaml"], ["--model with --plant"]),
        (["--columns", "voltage1=u"], ["no column 'u' (asked for as voltage1)"]),
        (["--columns", "position1=voltage1"], ["'position1' is not read here", "voltage1"]),
        (["--initial", "0,90,0"], ["--initial: '0,90,0': 90 rad is 14 turns; degrees?", "90deg"]),
        (["--initial", "0,90volt,0"], ["--initial: '0,90volt,0'", "or 90deg"]),
        (["--effect", "coulomb_friction:joint=2"], ["'torque' is missing", "torque=VALUE in N.m"]),
        (["--effect", "coulomb_friction:joint=2,torque=-3"], ["torque=-3", "0 to 500 N.m"]),
        (["--effect", "coulomb_friction:joint=2,torque=x"], ["torque=x", "a number"]),
        (["--effect", "coulomb_friction:joint=5,torque=3"], ["joint", "1, 2 or 3"]),
        (
            ["--effect", "coulomb_friction:joint=2,torque=3", "--effect", "coulomb_friction:joint=2,torque=4"],
            ["coulomb_friction stands twice on joint 2"],
        ),
        (["--constrain", "joint4=hold"], ["--constrain: 'joint4=hold'", "joint1, joint2 or joint3"]),
        (["--constrain", "joint1"], ["--constrain joint1", "free or hold"]),
        (["--constrain", "joint1=stuck"], ["--constrain joint1=stuck", "free or hold or velocity"]),
        (["--constrain", "joint1=acceleration"], ["no value", "acceleration:"]),
        (["--constrain", "joint1=velocity:fast"], ["value 'fast'", "a number"]),
        (["--constrain", "joint1=hold:1"], ["value 1.0", "no value"]),
        (["--constrain", "joint1=hold", "--constrain", "joint1=free"], ["joint1 stands twice"]),
        (
            ["--constrain", "joint1=hold", "--initial-velocity", "1,0,0"],
            ["initial velocity 1.0 rad/s of joint 1", "0.0 rad/s"],
        ),
        (["--limits", "off", "--max-velocity", "1,1,1"], ["--max-velocity with --limits off"]),
        (["--max-acceleration", "1,-1,1"], ["--max-acceleration: '1,-1,1'", "no number below 0"]),
    ],
)
def test_an_option_that_cannot_be_used_is_refused(tmp_path, volts, assert_refused, options, says):
    assert_refused("simulate", volts, "--out", tmp_path / "run.csv", *options, says=says)


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "COMMAND"),
        (["jump"], "argument COMMAND: 'jump'"),
        (["simulat"], "expected simulate, which is near"),
        (["simulate"], "--out"),
        (["simulate", "volts.csv"], "--out"),
        (["simulate", "volts.csv", "--out", "x.csv", "--init", "1,2,3"], "--init"),
        (["simulate", "volts.csv", "--out", "x.csv", "--model", "m", "--parameters", "p"], "not allowed with"),
        (["simulate", "volts.csv", "--out", "x.csv", "--torque-form", "thesis"], "expected one of physical, printed"),
        (["simulate", "volts.csv", "--outt", "x.csv"], "unknown option '--outt'; expected --out"),
        (["explain", "a.csv", "--see", "1"], "usage: puma-sim explain"),
        (["mechanism", "new", "x.yaml", "--kind", "slide", "--driv", "none"], "usage: puma-sim mechanism new"),
        (["replay", "bag", "other"], "'other' is one argument too many"),
    ],
)
def test_a_wrong_command_line_is_refused(arguments, says, capsys):
    with pytest.raises(SystemExit) as end:
        call(*arguments)
    assert end.value.code == 2
    assert says in capsys.readouterr().err


# --------------------------------------------------------------------------------------- output


def test_an_output_that_cannot_be_written_is_refused_before_the_run(tmp_path, volts, assert_refused):
    assert_refused("simulate", volts, "--out", tmp_path / "no" / "run.csv", says=["run.csv: its folder does not exist"])
    assert_refused("simulate", volts, "--out", tmp_path, says=["is a folder"])
    assert_refused("simulate", volts, "--out", volts / "run.csv", says=["its folder does not exist"])


def test_an_input_is_never_written_over(tmp_path, volts, assert_refused):
    model = tmp_path / "model.yaml"
    dump_model(Plant.of(), model)
    (tmp_path / "link.csv").symlink_to(volts)
    for out in (volts, tmp_path / "link.csv", model):
        assert_refused("simulate", volts, "--out", out, "--model", model, says=["is an input"])
    assert_refused("model", "--model", model, "--out", model, says=["is an input"])


def test_a_device_is_written_to_and_not_replaced(volts):
    assert call("simulate", volts, "--out", "/dev/null") == 0
    with open("/dev/null", "rb") as null:
        assert null.read() == b""


def test_a_failed_run_leaves_an_older_output_as_it_was(tmp_path, assert_refused):
    bad = write_volts(tmp_path / "volts.csv", [0.0, 0.1, 0.2], [(0, 0, 0), (1e300, 0, 0), (0, 0, 0)])
    (tmp_path / "run.csv").write_text("mine")
    assert_refused(
        *("simulate", bad, "--force", "--out", tmp_path / "run.csv"),
        says=["volts.csv, row 3 (0.2 s): the state is no longer finite"],
    )


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path, volts, assert_refused):
    assert_refused("simulate", volts, "--out", "/dev/full", says=["/dev/full: cannot be written (No space"])


def test_times_that_cannot_be_seconds_are_refused(tmp_path, assert_refused):
    bad = write_volts(tmp_path / "volts.csv", [0.0, 1e18], [(0, 0, 0), (0, 0, 0)])
    assert_refused("simulate", bad, "--out", tmp_path / "run.csv", says=["volts.csv: lasts 1e+18 s"])


# ------------------------------------------------------------------------------- measured logs


@pytest.mark.parametrize(
    "header, says",
    [
        (HEADER, ["column 'position1' is missing", "position3"]),
        (f"{HEADER},position1,position2", ["column 'position3' is missing"]),
        (
            f"{HEADER},position1,position2,position3,velocity1",
            ["only 1 of the columns velocity1..3", "all of them or none"],
        ),
        ("time,position1,position2,position3", ["column 'voltage1' is missing"]),
    ],
)
def test_a_log_without_its_columns_is_refused(tmp_path, assert_refused, header, says):
    log = tmp_path / "log.csv"
    width = header.count(",")
    log.write_text(f"{header}\n" + "".join(f"{t}{',0' * width}\n" for t in range(5)))
    assert_refused("simulate", log, "--out", tmp_path / "run.csv", "--restart", "2", says=["log.csv, line 1", *says])


@pytest.mark.parametrize(
    "options, says",
    [
        (["--restart", "0"], ["0.0 s", "a positive number"]),
        (["--restart", "-2"], ["-2.0 s", "a positive number"]),
        (["--restart", "often"], ["--restart: 'often'", "a finite number"]),
        (["--restart", "2", "--initial", "0,0,0"], ["--initial with --restart", "measured state"]),
        (["--restart", "2", "--initial-current", "0,0,0"], ["--initial-current with --restart"]),
    ],
)
def test_a_restart_that_makes_no_sense_is_refused(tmp_path, assert_refused, options, says):
    log = tmp_path / "log.csv"
    log.write_text(f"{HEADER},position1,position2,position3\n" + "".join(f"{t}{',0' * 6}\n" for t in range(5)))
    assert_refused("simulate", log, "--out", tmp_path / "run.csv", *options, says=says)


def test_a_log_of_one_row_is_refused(tmp_path, assert_refused):
    log = tmp_path / "log.csv"
    log.write_text(f"{HEADER},position1,position2,position3\n0,0,0,0,0,0,0\n")
    assert_refused(
        "simulate",
        log,
        "--out",
        tmp_path / "run.csv",
        "--restart",
        "2",
        says=["log: 1 row with voltage, position", "two rows or more"],
    )


def test_a_log_that_the_arm_cannot_follow_is_named_by_its_row(tmp_path, assert_refused):
    log = tmp_path / "log.csv"
    log.write_text(
        f"{HEADER},position1,position2,position3\n"
        + "".join(f"{r * 0.1},{1e300 if r == 33 else 0},0,0,0,0,0\n" for r in range(50))
    )
    assert_refused(
        "simulate",
        log,
        "--out",
        tmp_path / "run.csv",
        "--restart",
        "2",
        says=["log.csv, row 35 (3.4 s): the state is no longer finite"],
    )


def test_an_unknown_kernel_is_named(tmp_path):
    volts = random_volts(tmp_path / "volts.csv", rows=5)
    done = puma_sim("simulate", volts, "--out", tmp_path / "run.csv", PUMA_SIM_KERNEL="fortran")
    assert done.returncode == 2
    assert "PUMA_SIM_KERNEL: kernel 'fortran'" in done.stderr and "Traceback" not in done.stderr
    assert list(contents(tmp_path)) == ["volts.csv"]
