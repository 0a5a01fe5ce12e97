# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a page of a motion shows: chains, sources, and errors; the page itself is in test_view_browser.py."""

from __future__ import annotations

import json
import socket
import sys

import numpy as np
import pytest
from bag_sessions import record
from cli_support import call

import puma_sim_core as ps
from puma_sim_core.arm.kinematics import wrist_path
from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.recording.recording import Recording, write_csv
from puma_sim_core.view import sources
from puma_sim_core.view.chain import chain_of_plant, chain_of_urdf
from puma_sim_core.view.motion import MODEL, SETPOINT

TIME = np.arange(0.0, 2.0, 0.005)


def simulated(plant: ps.Plant, folder, name: str = "run.csv"):
    """The path of a run with smooth voltages."""
    simulator = ps.Simulator(plant)
    simulator.reset(position=(0.0, -1.2, 1.0)[: plant.joints])
    volts = 8.0 * np.sin(np.outer(TIME, np.arange(2.0, 2.0 + plant.joints)))
    write_csv(simulator.run(TIME, volts), folder / name)
    return folder / name


def report(folder, log, plant: ps.Plant | None):
    """A folder as `explain` leaves it, as far as a page needs it."""
    folder.mkdir()
    (folder / "report.json").write_text(json.dumps({"logs": [str(log)]}), encoding="utf-8")
    if plant is not None:
        ps.dump_model(plant, folder / "model.yaml")
    return folder


# -- chains ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ps.parameter_sets())
def test_the_end_of_the_chain_is_the_wrist(name):
    arm = ps.load_parameters(name)
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (50, 3))
    np.testing.assert_allclose(chain_of_urdf(arm_urdf(arm)).end(q), wrist_path(q, arm), rtol=0.0, atol=1e-12)


def test_a_pendulum_hangs_down_and_turns_by_its_length():
    q = np.linspace(-3.0, 3.0, 13)
    end = chain_of_plant(ps.load_mechanism("pendulum").plant()).end(q[:, None])
    length = 0.10  # config/mechanisms/pendulum.yaml
    np.testing.assert_allclose(end, np.stack([length * np.sin(q), 0.0 * q, -length * np.cos(q)], axis=1), atol=1e-12)


def test_a_slide_goes_along_its_guide():
    end = chain_of_plant(ps.load_mechanism("slide").plant()).end(np.array([[-0.05], [0.3]]))
    np.testing.assert_allclose(end, [[-0.05, 0.0, 0.0], [0.3, 0.0, 0.0]])


@pytest.mark.parametrize(
    "text",
    ["", "<robot/>", "<robot><link name='a'/><link name='b'/></robot>", "<robot><link name='a'/><joint/></robot>"],
)
def test_what_is_no_chain_is_refused(text):
    with pytest.raises(ps.ModelError, match="one chain of links"):
        chain_of_urdf(text)


# -- sources --------------------------------------------------------------------------------------


def test_a_session_has_the_setpoints_that_it_was_commanded(tmp_path):
    urdf = arm_urdf(ps.load_parameters("bejczy"))
    bag = ps.read_bag(record(tmp_path / "bag", 30, "position", urdf=urdf))
    motion = sources.session_motion(tmp_path / "bag")
    assert np.array_equal(motion.position, bag.position)
    # a voltage holds from the state before the one that it is recorded with
    assert np.array_equal(motion.voltage[:-1], bag.voltage[1:])
    expected = bag.position[0].copy()
    for k in range(31):
        for step, command in bag.commands:
            if step == k:
                for joint, value in zip(command.names or bag.joint_names, command.values):
                    expected[bag.joint_names.index(joint)] = value
        assert np.array_equal(motion.setpoint[k], expected)


def test_a_session_in_volts_has_no_setpoint(tmp_path):
    record(tmp_path / "bag", 3, urdf=arm_urdf(ps.load_parameters("bejczy")))
    assert sources.session_motion(tmp_path / "bag").setpoint is None


def test_setpoints_of_another_file_hold_until_its_next_row(tmp_path):
    motion = sources.log_motion(simulated(ps.Plant.of(), tmp_path), ps.Plant.of(), compare=False)
    rows = np.array([0.5, 1.0])
    write_csv(Recording(rows, setpoint=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])), tmp_path / "setpoints.csv")
    found = sources.with_setpoints(motion, tmp_path / "setpoints.csv").arms[SETPOINT]
    assert np.array_equal(found, np.where(TIME[:, None] < 1.0 - 1e-9, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]))


def test_a_report_shows_the_log_beside_its_model(tmp_path):
    hidden = ps.parse_effect("coulomb_friction:joint=2,torque=12")
    true, plain = ps.Plant.of("bejczy", [hidden]), ps.Plant.of()
    log = simulated(true, tmp_path)
    right = sources.report_motion(report(tmp_path / "right", log, true))
    wrong = sources.report_motion(report(tmp_path / "wrong", log, plain))
    assert np.array_equal(right.position, wrong.position)
    # the model that made the log follows it from each start on, the other one does not
    assert np.abs(right.position - right.arms[MODEL]).max() < 1e-9
    assert np.abs(wrong.position - wrong.arms[MODEL])[:, 1].max() > 1e-3
    assert [figure.title for figure in right.figures()] == [
        *("Position", "Residual, arm minus model", "Motor voltage", "Motor current")
    ]


def test_a_report_finds_its_log_beside_it(tmp_path):
    log = simulated(ps.Plant.of(), tmp_path)
    folder = report(tmp_path / "report", "/moved/away/run.csv", ps.Plant.of())
    assert sources.report_motion(folder / "report.json").name.endswith(": run.csv")
    log.unlink()
    with pytest.raises(ps.RecordingError, match="--model"):
        sources.report_motion(folder)


def test_rows_without_numbers_are_left_out(tmp_path):
    path = simulated(ps.Plant.of(), tmp_path)
    lines = path.read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[5], "nan")
    path.write_text("\n".join(lines) + "\n")
    motion = sources.log_motion(path, ps.Plant.of())
    assert len(motion.time) == len(TIME) - 1 and np.isfinite(motion.arms[MODEL]).all()
    assert "1 rows without numbers are left out." in motion.notes


# -- the command ----------------------------------------------------------------------------------


def refused(capsys, *arguments) -> str:
    assert call("view", *arguments) == 2
    return capsys.readouterr().err


def test_bad_input_is_refused(tmp_path, capsys):
    log = simulated(ps.Plant.of(), tmp_path)
    assert "nothing.csv: cannot be read" in refused(capsys, tmp_path / "nothing.csv")
    assert "is not a bag" in refused(capsys, tmp_path)
    assert "--restart with a CSV" in refused(capsys, log, "--restart", "1")
    assert "--model with a report" in refused(
        capsys, report(tmp_path / "a", log, ps.Plant.of()), "--model", tmp_path / "a" / "model.yaml"
    )
    assert "has no model.yaml" in refused(capsys, report(tmp_path / "b", log, None))
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "report.json").write_text("[]")
    assert "report.json: cannot be read" in refused(capsys, tmp_path / "c")
    assert "is an input" in refused(capsys, log, "--export", log)
    assert "from 0 to 65535" in refused(capsys, log, "--port", "65536")
    assert "cannot be listened on" in refused(capsys, log, "--host", "no.such.host.invalid")
    path = tmp_path / "back.csv"
    path.write_text("\n".join([*log.read_text().splitlines(), log.read_text().splitlines()[5]]) + "\n")
    assert "times that increase" in refused(capsys, path)


def test_a_port_that_is_taken_is_named(tmp_path, capsys):
    log = simulated(ps.Plant.of(), tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"127.0.0.1, port {port}: cannot be listened on" in refused(capsys, log, "--port", port)


def test_without_viser_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    log = simulated(ps.Plant.of(), tmp_path)
    assert "pip install 'puma_sim_ros[view]'" in refused(capsys, log)


def test_the_same_motion_gives_the_same_page(tmp_path):
    pytest.importorskip("viser")
    log = simulated(ps.Plant.of(), tmp_path)
    for name in ("a.html", "b.html"):
        assert call("view", log, "--export", tmp_path / name) == 0
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_names_of_files_cannot_put_markup_into_a_page(tmp_path):
    pytest.importorskip("viser")
    log = simulated(ps.Plant.of(), tmp_path, "<b>bold<script>.csv")
    assert call("view", log, "--export", tmp_path / "page.html") == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<b>bold" not in text and "&lt;b&gt;bold" in text
