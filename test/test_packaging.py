# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What is installed: the files, the programs, and metadata that agree wherever they stand."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ElementTree
import zipfile
from email import message_from_string
from email.utils import parseaddr
from pathlib import Path

import pytest
import yaml

import puma_sim_core

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("puma_sim_core", "puma_sim_ros")
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
INSTALLED = [
    path
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*"))
    if path.is_file() and "__pycache__" not in path.parts
]
CONFIG_FILES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "config").rglob("*") if path.is_file())

#: the module that is imported, where it is not the name of its distribution
MODULE_OF = {"pyyaml": "yaml", "pin": "pinocchio", "roboticstoolbox-python": "roboticstoolbox"}


def package_xml() -> ElementTree.Element:
    return ElementTree.parse(ROOT / "package.xml").getroot()


# Setuptools writes into the tree that it builds, and would take files from an earlier build/.
@pytest.fixture(scope="module")
def source_tree(tmp_path_factory):
    """A clean copy of what packaging reads, with one configuration file that no list names."""
    setuptools = pytest.importorskip("setuptools", minversion="64")
    if tuple(map(int, setuptools.__version__.split(".")[:2])) < (70, 1):
        pytest.importorskip("wheel", reason="setuptools before 70.1 builds wheels by the package wheel alone")
    tree = tmp_path_factory.mktemp("source")
    for name in ("setup.py", "pyproject.toml", "package.xml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, tree)
    for name in (*PACKAGES, "config", "launch", "resource"):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    added = tree / "config" / "parameters" / "deeper" / "added_by_test.yaml"
    added.parent.mkdir()
    added.write_text("{}\n")
    return tree


def build(kind: str, tree: Path, out: Path) -> Path:
    code = f"import sys; from setuptools import build_meta; build_meta.build_{kind}(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", code, str(out)], cwd=tree, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert done.returncode == 0, done.stdout
    (product,) = out.iterdir()
    return product


@pytest.fixture(scope="module")
def wheel(source_tree, tmp_path_factory):
    with zipfile.ZipFile(build("wheel", source_tree, tmp_path_factory.mktemp("wheel"))) as archive:
        yield archive


@pytest.fixture(scope="module")
def metadata(wheel):
    (name,) = [n for n in wheel.namelist() if n.endswith(".dist-info/METADATA")]
    return message_from_string(wheel.read(name).decode())


@pytest.fixture(scope="module")
def entry_points(wheel):
    (name,) = [n for n in wheel.namelist() if n.endswith(".dist-info/entry_points.txt")]
    return dict(re.findall(r"^(\S+) = (\S+)$", wheel.read(name).decode(), re.MULTILINE))


# -- files ----------------------------------------------------------------------------------------


def test_every_configuration_file_is_in_the_wheel_as_package_data_and_in_share(wheel):
    names = wheel.namelist()
    assert CONFIG_FILES
    for name in [*CONFIG_FILES, "config/parameters/deeper/added_by_test.yaml"]:
        assert f"puma_sim_core/{name}" in names
        assert [n for n in names if n.endswith(f".data/data/share/puma_sim_ros/{name}")], name


def test_the_wheel_has_every_file_of_the_packages_and_what_ros_looks_for(wheel):
    names = wheel.namelist()
    for path in INSTALLED:
        assert path.relative_to(ROOT).as_posix() in names
    for name in ("share/puma_sim_ros/package.xml", "share/ament_index/resource_index/packages/puma_sim_ros"):
        assert [n for n in names if n.endswith(f".data/data/{name}")], name
    # programs come from the entry points, so that pip puts them on PATH
    assert not [n for n in names if "/scripts/" in n or "/lib/" in n]


def test_a_wheel_built_from_the_source_distribution_has_the_same_files(source_tree, wheel, tmp_path):
    (tmp_path / "sdist").mkdir()
    (tmp_path / "wheel").mkdir()
    with tarfile.open(build("sdist", source_tree, tmp_path / "sdist")) as archive:
        # Python 3.12 asks for a filter; early releases of 3.10 and 3.11 have none
        safe = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(tmp_path / "unpacked", **safe)
    (tree,) = (tmp_path / "unpacked").iterdir()
    with zipfile.ZipFile(build("wheel", tree, tmp_path / "wheel")) as again:
        assert sorted(again.namelist()) == sorted(wheel.namelist())


def test_installed_modules_read_their_own_configuration_not_that_of_a_checkout(wheel, tmp_path):
    wheel.extractall(tmp_path)
    code = (
        "from puma_sim_core.resources import config_path;"
        "print(config_path('parameters', 'deeper', 'added_by_test.yaml'))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        check=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        stdout=subprocess.PIPE,
    ).stdout.strip()
    assert Path(found).is_relative_to(tmp_path)


# -- metadata -------------------------------------------------------------------------------------


def test_package_xml_is_valid():
    packages = pytest.importorskip("catkin_pkg.package")
    warnings = []
    package = packages.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    assert not warnings
    assert package.name == "puma_sim_ros"
    assert package.get_build_type() == "ament_python"
    assert package.package_format == 3


def test_names_and_versions_agree(metadata):
    version = puma_sim_core.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert metadata["Version"] == version
    assert package_xml().findtext("version") == version
    assert re.search(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE).group(1) == version
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert metadata["Name"].replace("-", "_") == package_xml().findtext("name")


def test_the_licence_agrees_everywhere(metadata):
    assert package_xml().findtext("license") == "Apache-2.0"
    assert "Apache-2.0" in (metadata["License-Expression"], metadata["License"])
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["license"] == "Apache-2.0"
    text = (ROOT / "LICENSE").read_text()
    assert re.match(r"\s*Apache License\s+Version 2\.0, January 2004\s", text)
    assert "END OF TERMS AND CONDITIONS" in text
    assert package_xml().find("license").get("file") == "LICENSE"


@pytest.mark.parametrize(
    "path", [*SOURCES, *sorted((ROOT / "test").rglob("*.py"))], ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_each_source_file_names_licence_and_copyright(path):
    head = path.read_text(encoding="utf-8").split("\n")[:2]
    assert "# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0" in head


def test_the_maintainer_is_one_address_that_parses(metadata):
    maintainer = package_xml().find("maintainer")
    address = maintainer.get("email")
    assert parseaddr(f"{maintainer.text} <{address}>") == (maintainer.text, address)
    assert re.fullmatch(r"[\w.+-]+@([\w-]+\.)+[a-z]{2,}", address, re.IGNORECASE)
    assert parseaddr(metadata["Maintainer-email"])[1] == address
    author = yaml.safe_load((ROOT / "CITATION.cff").read_text())["authors"][0]
    assert (author["name"], author["email"]) == (maintainer.text, address)


# -- programs and dependencies --------------------------------------------------------------------


PROGRAMS = ["appraise", "appraised_controller", "external_controller", "puma-sim", "sim_node", "viewer"]


@pytest.mark.parametrize("program", PROGRAMS)
def test_each_program_leads_to_a_function(entry_points, program):
    module, function = entry_points[program].split(":")
    if module.startswith("puma_sim_ros"):
        pytest.importorskip("rclpy")
    assert callable(getattr(importlib.import_module(module), function))


def test_no_program_is_declared_that_is_not_checked(entry_points):
    assert sorted(entry_points) == PROGRAMS


def imported(package: str) -> set[str]:
    """Top-level names that the files of a package import, wherever in the file."""
    names = set()
    for path in (ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - {package}


def modules(requirements) -> set[str]:
    distributions = {re.match(r"[\w.-]+", text).group().lower() for text in requirements}
    return {MODULE_OF.get(name, name.replace("-", "_")) for name in distributions}


def test_each_import_is_a_declared_dependency(metadata):
    requirements = metadata.get_all("Requires-Dist")
    required = modules(r for r in requirements if "extra ==" not in r)
    optional = modules(r for r in requirements if re.search(r"extra == .(fast|cluster|view|completion).", r))
    ros = {e.text for e in package_xml().iter("exec_depend") if not e.text.startswith("python3-")}
    peers = re.search(r"^PEERS := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE).group(1)
    bench = modules(peers.split())

    core = imported("puma_sim_core")
    assert not core & ros, "puma_sim_core must not import ROS"
    # `puma-sim replay --publish` alone hands a bag over to the other package
    assert core <= required | optional | bench | {"puma_sim_ros"}
    assert imported("puma_sim_ros") <= required | optional | ros | {"puma_sim_core"}


def test_what_apt_and_rosdep_can_install_is_in_package_xml(metadata):
    keys = {e.text for e in package_xml().iter("exec_depend")}
    required = modules(r for r in metadata.get_all("Requires-Dist") if "extra ==" not in r)
    # these have no rosdep key: the page says how they come in
    by_pip = {"mcap", "rosbags", "threadpoolctl"}
    assert {f"python3-{module}" for module in required - by_pip} <= keys
    (line,) = re.findall(r"^pip install (.*?) *#", (ROOT / "docs" / "ros.md").read_text(), re.MULTILINE)
    assert by_pip <= set(line.split())


# -- what a newcomer is told ----------------------------------------------------------------------


#: packages that some tests take where they are there, beyond package.xml and the README's line
_OPTIONAL = ("mujoco", "pinocchio", "control", "mcap_ros2", "dask", "distributed", "argcomplete", "sphinx")


@pytest.mark.long
def test_every_test_file_can_be_read_without_packages_that_only_some_need(tmp_path):
    """As `colcon test` reads them: one file that cannot be read ends all tests."""
    for name in _OPTIONAL:
        text = f"raise ModuleNotFoundError('No module named {name}', name='{name}')"
        (tmp_path / f"{name}.py").write_text(text)
    path = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider", str(ROOT / "test")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path, "PUMA_SIM_KERNEL": "python"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]


@pytest.mark.parametrize("command", ["make run", "make test", "colcon build", "ros2 run puma_sim_ros sim_node"])
def test_the_readme_shows(command):
    assert command in (ROOT / "README.md").read_text()


def test_each_make_target_that_the_documents_name_exists():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for document in ("README.md", "CONTRIBUTING.md", "QUALITY_DECLARATION.md", "CHANGELOG.md"):
        for target in re.findall(r"`make ([\w-]+)", (ROOT / document).read_text()):
            assert target in targets, f"{document} names make {target}"


# -- the launch files and what they start ---------------------------------------------------------


def test_the_launch_files_and_their_settings_are_installed(wheel):
    names = wheel.namelist()
    for path in (
        *sorted((ROOT / "launch").iterdir()),
        ROOT / "config" / "puma560.rviz",
        ROOT / "config" / "foxglove.json",
    ):
        end = f".data/data/share/puma_sim_ros/{path.parent.name}/{path.name}"
        assert [name for name in names if name.endswith(end)], end


@pytest.mark.parametrize(("environment", "wanted"), [({}, True), ({"PUMA_SIM_HEADLESS": "1"}, False)])
def test_rviz_is_a_dependency_that_can_be_left_out(environment, wanted):
    packages = pytest.importorskip("catkin_pkg.package")
    package = packages.parse_package(str(ROOT / "package.xml"))
    package.evaluate_conditions(environment)
    found = {each.name for each in package.exec_depends if each.evaluated_condition}
    assert ({"rviz2", "robot_state_publisher"} <= found) == wanted
    assert {"rclpy", "launch_ros"} <= found


def test_rviz_and_foxglove_show_what_the_node_publishes():
    rviz = yaml.safe_load((ROOT / "config" / "puma560.rviz").read_text())["Visualization Manager"]
    (model,) = [each for each in rviz["Displays"] if each["Class"] == "rviz_default_plugins/RobotModel"]
    assert model["Description Topic"]["Value"] == "/robot_description"
    assert model["Description Topic"]["Durability Policy"] == "Transient Local"
    assert rviz["Global Options"]["Fixed Frame"] == "base_link"

    layout = json.loads((ROOT / "config" / "foxglove.json").read_text())
    panels, shown = layout["configById"], re.findall(r'"([^"]+![^"]+)"', json.dumps(layout["layout"]))
    assert sorted(shown) == sorted(panels)
    arm = panels["3D!arm"]["layers"]["arm"]
    assert (arm["topic"], arm["jointStatesTopic"]) == ("/robot_description", "/joint_states")
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    fields = {"/joint_states": "position", "/motor_voltages": "data", "/motor_currents": "data"}
    assert sorted(paths) == sorted(f"{topic}.{field}[{joint}]" for topic, field in fields.items() for joint in range(3))
